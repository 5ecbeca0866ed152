"""Errors on a recording's test part of models trained on its own labels, few and all."""

from eitskin.data import dataset, splits
from eitskin.learn import metrics, model_file, transfer
from eitskin.learn.train import Budget, Recipe
from eitskin.provenance import recorded

with recorded(snakemake):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    recipe = Recipe.from_settings(params.recipe, Budget(**params.budget), params.latent_dim)
    rows = transfer.references(model_file.read_seeds(files.models), data, part, recipe, params.seed)
    metrics.write(rows, snakemake.output[0])
