"""Seal all verdicts of a block."""

from pathlib import Path

from concealed import sealing
from eitskin.errors import reported

with reported(snakemake.log[0]):
    sealing.seal(Path(snakemake.output[0]).parent)
