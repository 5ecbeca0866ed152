"""Draw the tables of a block's score."""

from pathlib import Path

from eitskin.errors import reported
from proof import figures

with reported(snakemake.log[0]):
    tables = [Path(path) for path in snakemake.input]
    figures.write(tables[0].parent, [table.stem for table in tables])
