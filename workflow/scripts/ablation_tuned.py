"""Train a model with the chosen recipe."""

import json
from pathlib import Path

from eitskin.data import dataset, splits
from eitskin.learn.train import Budget, Recipe, Seeds, Split, train_predictor
from eitskin.provenance import recorded

with recorded(snakemake):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    choice = json.loads(Path(files.choice).read_text(encoding="utf-8"))
    recipe = Recipe.from_settings(choice["recipe"], Budget(**params.budget))
    job = (recipe, Seeds(params.draw, params.seed), files.teachers)
    train_predictor(Split(data, part), snakemake.wildcards.model, snakemake.output[0], *job)
