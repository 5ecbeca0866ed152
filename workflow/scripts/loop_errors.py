"""A model trained on one simulator of a skin, tested on the skin's recording."""

from pathlib import Path

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn import transfer
from eitskin.learn.train import Budget, Optimiser, Recipe
from loop import errors

with reported(snakemake.log[0]):
    params, files = snakemake.params, snakemake.input
    target = dataset.read(files.target)
    part = splits.read(files.split, target.table)
    chosen = (snakemake.wildcards.source, snakemake.wildcards.model, Path(files.recording).parent)
    optimiser = Optimiser(params.learning_rate, params.weight_decay, params.batch_size)
    settings = (params.latent_dim, params.force_weight, params.lambda_latent)
    recipe = Recipe(optimiser, Budget(**params.budget), *settings)
    drawn = (params.authors, params.forces, params.probe_mm)
    rows = errors.errors(*chosen, target, part, recipe, params.seed, *drawn)
    transfer.write(rows, snakemake.output[0])
