"""What others make of a batch of concealed recordings, given these and their queries alone."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import baselines

with recorded(snakemake):
    baselines.run(
        snakemake.params.cases,
        Path(snakemake.input.recordings[0]).parents[1],
        snakemake.params.seed,
        snakemake.params.code,
    )
