"""Fit what was concealed in a batch of opened recordings."""

from pathlib import Path

from eitskin.errors import reported
from proof import oracle

with reported(snakemake.log[0]):
    oracle.run(
        snakemake.params.cases,
        Path(snakemake.input.opened).parent,
        snakemake.params.seed,
        snakemake.params.code,
    )
