"""Collect the errors of models on the validation part at every point of the grid."""

import pandas as pd

from eitskin.paper import tuning
from eitskin.provenance import recorded

with recorded(snakemake):
    params = snakemake.params
    rows = [
        tuning.row(pd.read_csv(path), point, params.grid[point["setting"]], params.budget)
        for path, point in zip(snakemake.input.errors, params.points, strict=True)
    ]
    tuning.write(rows, snakemake.output[0])
