"""Stage 3: the predictor, plain or physics-informed."""

from eitskin.data import dataset, splits
from eitskin.learn.train import Budget, Recipe, Seeds, Split, train_predictor
from eitskin.provenance import recorded

with recorded(snakemake):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    recipe = Recipe.from_settings(params.recipe, Budget(**params.budget))
    job = (recipe, Seeds(params.draw, params.seed), files.teachers)
    train_predictor(Split(data, part), snakemake.wildcards.model, snakemake.output[0], *job)
