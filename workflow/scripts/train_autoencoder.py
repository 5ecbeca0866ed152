"""Stage 1: the autoencoder of the voltages."""

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_autoencoder

with reported(snakemake.log[0]):
    params = snakemake.params
    data = dataset.read(snakemake.input.dataset)
    part = splits.read(snakemake.input.split, data.table)
    job = (snakemake.output[0], Optimiser(**params.optimiser), Budget(**params.budget))
    train_autoencoder(data, part, *job, params.draw, params.seed, params.latent_dim)
