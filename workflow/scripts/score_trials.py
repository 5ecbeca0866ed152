"""Score the diagnoses of recordings with known truth."""

from pathlib import Path

from calibration import score
from eitskin.errors import reported

with reported(snakemake.log[0]):
    folder = Path(snakemake.output[0]).parent
    score.write(folder, snakemake.params.block, snakemake.params.size)
