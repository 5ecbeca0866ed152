"""Draw the tables of a block's score."""

from pathlib import Path

from eitskin.provenance import recorded
from proof import figures

with recorded(snakemake):
    tables = [Path(path) for path in snakemake.input.tables]
    figures.write(tables[0].parent, [table.stem for table in tables])
