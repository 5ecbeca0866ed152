"""Stage 1: the autoencoder of the voltages, every seed."""

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_autoencoder

with reported(snakemake.log[0]):
    params = snakemake.params
    data = dataset.read(snakemake.input.dataset)
    part = splits.read(snakemake.input.split, data.table)
    optimiser = Optimiser(params.learning_rate, params.weight_decay, params.batch_size)
    budget = Budget(**params.budget)
    out = snakemake.output[0]
    train_autoencoder(data, part, out, optimiser, budget, params.seed, params.latent_dim)
