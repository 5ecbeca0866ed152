"""Diagnose a batch of concealed recordings, given these and their queries alone."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import verdicts

with recorded(snakemake):
    verdicts.run(
        snakemake.params.cases,
        Path(snakemake.input.recordings[0]).parents[1],
        Path(snakemake.input.schema),
        snakemake.params.seed,
        snakemake.params.code,
    )
