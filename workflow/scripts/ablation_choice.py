"""Choose the setting of the grid with the best score on the validation part."""

import json
from pathlib import Path

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.paper import ablation
from eitskin.provenance import recorded

with recorded(snakemake):
    params = snakemake.params
    grid, axes = params.grid, params.axes
    best_setting = ablation.best(
        dict(zip(grid, map(pd.read_csv, snakemake.input.errors), strict=True))
    )
    with atomic_path(snakemake.output[0]) as path:
        words = ablation.in_words(grid[best_setting], axes)
        text = json.dumps({"recipe": params.recipes[best_setting], "told": words})
        Path(path).write_text(f"{text}\n", encoding="utf-8")
