"""Stage 1: the autoencoder of the voltages."""

from eitskin.data import dataset, splits
from eitskin.learn.train import Budget, Optimiser, Seeds, Split, train_autoencoder
from eitskin.provenance import recorded

with recorded(snakemake):
    params = snakemake.params
    data = dataset.read(snakemake.input.dataset)
    part = splits.read(snakemake.input.split, data.table)
    job = (snakemake.output[0], Optimiser(**params.optimiser), Budget(**params.budget))
    seeds = Seeds(params.draw, params.seed)
    train_autoencoder(Split(data, part), *job, seeds, params.latent_dim)
