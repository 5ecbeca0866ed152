"""A model trained on one simulator of a skin, tested on the skin's recording."""

from pathlib import Path

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn import metrics
from eitskin.learn.train import Budget, Recipe
from loop import errors

with reported(snakemake.log[0]):
    params, files, names = snakemake.params, snakemake.input, snakemake.wildcards
    target = dataset.read(files.target)
    part = splits.read(files.split, target.table)
    recipe = Recipe.from_settings(params.recipe, Budget(**params.budget), params.latent_dim)
    chosen = (names.source, names.model, Path(files.recording).parent, target, part, recipe)
    drawn = (params.authors, params.forces, params.probe_mm)
    metrics.write(errors.errors(*chosen, params.seed, params.draw, *drawn), snakemake.output[0])
