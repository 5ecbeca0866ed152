"""Collect the errors of models on the validation part at every point of the grid."""

import pandas as pd

from eitskin.errors import reported
from eitskin.paper import tuning

with reported(snakemake.log[0]):
    params = snakemake.params
    rows = [
        tuning.row(pd.read_csv(path), point, params.grid[point["setting"]], params.budget)
        for path, point in zip(snakemake.input, params.points, strict=True)
    ]
    tuning.write(rows, snakemake.output[0])
