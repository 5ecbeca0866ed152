"""Collect Table I."""

from eitskin.errors import reported
from eitskin.paper import table_1

with reported(snakemake.log[0]):
    files, tables = snakemake.input, snakemake.output
    repeated = snakemake.params.repeated
    table_1.write(files.metrics, files.paper, repeated, files.limits, tables.csv, tables.markdown)
