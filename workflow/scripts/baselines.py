"""What others make of a batch of concealed recordings, given these and their queries alone."""

from pathlib import Path

from concealed import baselines
from eitskin.errors import reported

with reported(snakemake.log[0]):
    baselines.run(
        snakemake.params.cases,
        Path(snakemake.input.recordings[0]).parents[1],
        snakemake.params.seed,
        snakemake.params.code,
    )
