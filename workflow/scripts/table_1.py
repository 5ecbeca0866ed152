"""Collect Table I."""

from eitskin import table_1
from eitskin.errors import reported

with reported(snakemake.log[0]):
    tables = snakemake.output
    table_1.write(snakemake.input.metrics, snakemake.input.paper, tables.csv, tables.markdown)
