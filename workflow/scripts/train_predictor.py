"""Stage 3: the predictor, plain or physics-informed."""

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_predictor

with reported(snakemake.log[0]):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    job = (snakemake.output[0], Optimiser(**params.optimiser), Budget(**params.budget))
    loss = (params.force_weight, params.lambda_latent, files.teachers)
    train_predictor(data, part, snakemake.wildcards.model, *job, params.draw, params.seed, *loss)
