"""Stage 2: the regressor from states to latent voltages, every seed."""

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_regressor

with reported(snakemake.log[0]):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    optimiser = Optimiser(params.learning_rate, params.weight_decay, params.batch_size)
    budget = Budget(**params.budget)
    out = snakemake.output[0]
    train_regressor(data, part, files.autoencoder, out, optimiser, budget, params.seed)
