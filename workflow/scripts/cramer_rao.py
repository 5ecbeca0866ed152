"""Bound the errors of place and force over the skin."""

import pandas as pd

from eitskin.data import dataset
from eitskin.learn import metrics
from eitskin.limit import cramer_rao, posterior_mean
from eitskin.provenance import recorded

with recorded(snakemake):
    files, params = snakemake.input, snakemake.params
    blocks = ("skin", "accuracy", "effects", "session_frames", "continuous")
    experiment = posterior_mean.experiment_of(
        dataset.read(files.dataset), **{block: params[block] for block in blocks}
    )
    bounds = cramer_rao.table(experiment, pd.read_csv(files.touch_grid))
    metrics.write(bounds, snakemake.output[0])
