"""Collect Table I."""

from eitskin import table_1
from eitskin.errors import reported

with reported(snakemake.log[0]):
    table_1.write(list(snakemake.input), snakemake.output.csv, snakemake.output.markdown)
