"""Seal all verdicts of a block."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import sealing

with recorded(snakemake):
    sealing.seal(Path(snakemake.output[0]).parent)
