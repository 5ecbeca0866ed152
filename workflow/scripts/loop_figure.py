"""The figure of the closed loop for one model."""

from pathlib import Path

from eitskin.provenance import recorded
from loop import figure

with recorded(snakemake):
    figures = (Path(snakemake.output[suffix]) for suffix in ("svg", "png", "csv"))
    figure.write(Path(snakemake.input[0]), snakemake.wildcards.model, *figures)
