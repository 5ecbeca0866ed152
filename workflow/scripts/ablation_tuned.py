"""Train a model with the setting that was chosen."""

import json
from pathlib import Path

from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_predictor

with reported(snakemake.log[0]):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    setting = json.loads(Path(files.choice).read_text(encoding="utf-8"))["setting"]
    optimiser = Optimiser(**{key: setting[key] for key in params.optimiser})
    job = (snakemake.output[0], optimiser, Budget(**params.budget), params.draw, params.seed)
    loss = (setting["force_weight"], params.lambda_latent, files.teachers)
    train_predictor(data, part, snakemake.wildcards.model, *job, *loss)
