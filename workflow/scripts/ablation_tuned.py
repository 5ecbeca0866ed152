"""Train a model with the setting of the grid that did best on the validation part."""

from pathlib import Path

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import dataset, splits
from eitskin.errors import reported
from eitskin.learn.train import Budget, Optimiser, train_predictor
from eitskin.paper import ablation

with reported(snakemake.log[0]):
    params, files = snakemake.params, snakemake.input
    data = dataset.read(files.dataset)
    part = splits.read(files.split, data.table)
    scores = map(pd.read_csv, files.scores)
    chosen = ablation.best(dict(zip(params.grid, scores, strict=True)))
    setting = params.grid[chosen]
    optimiser = Optimiser(setting["learning_rate"], setting["weight_decay"], setting["batch_size"])
    job = (snakemake.wildcards.model, snakemake.output.model, optimiser, Budget(**params.budget))
    loss = (setting["force_weight"], params.lambda_latent, files.teachers)
    train_predictor(data, part, *job, params.seed, *loss)
    told = ", ".join(f"{key.replace('_', ' ')} {setting[key]:g}" for key in params.axes)
    with atomic_path(snakemake.output.chosen) as temporary:
        Path(temporary).write_text(f"{told}\n", encoding="utf-8")
