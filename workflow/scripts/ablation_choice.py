"""Choose the setting of the grid that did best on the validation part."""

import json
from pathlib import Path

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.errors import reported
from eitskin.paper import ablation

with reported(snakemake.log[0]):
    grid, axes = snakemake.params.grid, snakemake.params.axes
    chosen = ablation.best(dict(zip(grid, map(pd.read_csv, snakemake.input), strict=True)))
    with atomic_path(snakemake.output[0]) as path:
        text = json.dumps({"setting": grid[chosen], "told": ablation.in_words(grid[chosen], axes)})
        Path(path).write_text(f"{text}\n", encoding="utf-8")
