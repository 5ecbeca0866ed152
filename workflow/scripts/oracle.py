"""Fit what was concealed in a batch of opened recordings."""

from pathlib import Path

from concealed import oracle
from eitskin.errors import reported

with reported(snakemake.log[0]):
    oracle.run(
        snakemake.params.cases,
        Path(snakemake.input.opened).parent,
        snakemake.params.seed,
        snakemake.params.code,
    )
