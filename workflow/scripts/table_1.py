"""Collect Table I."""

from eitskin.paper import table_1
from eitskin.provenance import recorded

with recorded(snakemake):
    files, tables = snakemake.input, snakemake.output
    repeated = snakemake.params.repeated
    table_1.write(files.metrics, files.paper, repeated, files.limits, tables.csv, tables.markdown)
