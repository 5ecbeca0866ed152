"""Bound the errors of place and force over the skin."""

import pandas as pd

from eitskin import cramer_rao, dataset, limit
from eitskin.errors import reported

with reported(snakemake.log[0]):
    files, params = snakemake.input, snakemake.params
    blocks = ("skin", "accuracy", "effects", "session_frames", "continuous")
    experiment = limit.experiment_of(
        dataset.read(files.dataset), **{block: params[block] for block in blocks}
    )
    found = cramer_rao.table(experiment, pd.read_csv(files.touch_grid))
    limit.write(found, snakemake.output[0])
