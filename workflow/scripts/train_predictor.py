"""Stage 3: the predictor, plain or physics-informed, every seed."""

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_predictor

with reported(snakemake.log[0]):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    optimiser = Optimiser(params.learning_rate, params.weight_decay, params.batch_size)
    job = (snakemake.wildcards.model, snakemake.output[0], optimiser, Budget(**params.budget))
    loss = (params.force_weight, params.lambda_latent, files.teachers)
    train_predictor(data, part, *job, params.seed, *loss)
