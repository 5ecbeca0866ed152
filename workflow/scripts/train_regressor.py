"""Stage 2: the regressor from states to latent voltages."""

from eitskin.data import dataset, splits
from eitskin.learn.train import Budget, Optimiser, Seeds, Split, train_regressor
from eitskin.provenance import recorded

with recorded(snakemake):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    job = (snakemake.output[0], Optimiser(**params.optimiser), Budget(**params.budget))
    seeds = Seeds(params.draw, params.seed)
    train_regressor(Split(data, part), files.autoencoder, *job, seeds)
