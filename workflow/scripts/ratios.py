"""Hold models of a continuous set against the posterior mean, on the samples that it estimated."""

from pathlib import Path

import pandas as pd

from eitskin.errors import reported
from eitskin.learn import metrics
from eitskin.limit import ratios

with reported(snakemake.log[0]):
    found = ratios.ratios(
        {Path(file).stem: pd.read_parquet(file) for file in snakemake.input.predictions},
        pd.read_csv(snakemake.input.samples),
        snakemake.wildcards.configuration,
        snakemake.params.seed,
    )
    metrics.write(found, snakemake.output[0])
