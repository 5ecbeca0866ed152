"""Compare models of a continuous set with the posterior mean, on the same samples."""

from pathlib import Path

import pandas as pd

from eitskin.learn import metrics
from eitskin.limit import ratios
from eitskin.provenance import recorded

with recorded(snakemake):
    table = ratios.ratios(
        {Path(file).stem: pd.read_parquet(file) for file in snakemake.input.predictions},
        pd.read_csv(snakemake.input.samples),
        snakemake.wildcards.configuration,
        snakemake.params.seed,
    )
    metrics.write(table, snakemake.output[0])
