"""Seal all verdicts of a block."""

from pathlib import Path

from eitskin.errors import reported
from proof import sealing

with reported(snakemake.log[0]):
    sealing.seal(Path(snakemake.output[0]).parent)
