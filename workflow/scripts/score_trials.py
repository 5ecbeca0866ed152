"""Score the diagnoses of recordings with known truth."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import score

with recorded(snakemake):
    folder = Path(snakemake.output[0]).parent
    score.write(folder, snakemake.params.block, snakemake.params.size)
