"""Draw the score of an opened block."""

from pathlib import Path

from concealed import figures
from eitskin.errors import reported

with reported(snakemake.log[0]):
    figures.write(Path(snakemake.output[0]).parent)
