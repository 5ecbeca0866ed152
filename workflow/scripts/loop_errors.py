"""A model trained on one simulator of a skin, tested on the skin's recording."""

from pathlib import Path

from eitskin.data import dataset, splits
from eitskin.learn import metrics
from eitskin.learn.train import Budget, Recipe, Split
from eitskin.provenance import recorded
from eitskin.simulate.imitation import PressPrior
from loop import errors

with recorded(snakemake):
    params, files, names = snakemake.params, snakemake.input, snakemake.wildcards
    target = dataset.read(files.target)
    split = Split(target, splits.read(files.split, target.table))
    recipe = Recipe.from_settings(params.recipe, Budget(**params.budget), params.latent_dim)
    prior = PressPrior(params.forces, params.probe_mm)
    case = errors.Case(Path(files.recording).parent, split, params.authors, prior)
    job = (names.source, names.model, recipe, params.seed, params.draw)
    metrics.write(errors.errors(case, *job), snakemake.output[0])
