"""Diagnose a batch of concealed recordings, given these and their queries alone."""

from pathlib import Path

from eitskin.errors import reported
from proof import verdicts

with reported(snakemake.log[0]):
    verdicts.run(
        snakemake.params.cases,
        Path(snakemake.input.recordings[0]).parents[1],
        Path(snakemake.input.schema),
        snakemake.params.seed,
        snakemake.params.code,
    )
