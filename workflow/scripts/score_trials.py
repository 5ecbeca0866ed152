"""Score the diagnoses of recordings with known truth."""

from pathlib import Path

from eitskin.errors import reported
from proof import score

with reported(snakemake.log[0]):
    folder = Path(snakemake.output[0]).parent
    score.write(folder, snakemake.params.block, snakemake.params.size)
