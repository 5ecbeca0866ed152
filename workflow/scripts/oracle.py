"""Fit what was concealed in a batch of opened recordings."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import oracle

with recorded(snakemake):
    oracle.run(
        snakemake.params.cases,
        Path(snakemake.input.opened).parent,
        snakemake.params.seed,
        snakemake.params.code,
    )
