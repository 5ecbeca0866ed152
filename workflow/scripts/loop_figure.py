"""The figure of the closed loop for one model."""

from pathlib import Path

from eitskin.errors import reported
from loop import figure

with reported(snakemake.log[0]):
    figures = (Path(snakemake.output[suffix]) for suffix in ("svg", "png", "csv"))
    figure.write(Path(snakemake.input[0]), snakemake.wildcards.model, *figures)
