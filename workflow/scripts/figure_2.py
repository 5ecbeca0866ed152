"""Draw the workflow: figure 2."""

from eitskin.paper import figure_2
from eitskin.provenance import recorded

with recorded(snakemake):
    files, asked = snakemake.output, snakemake.params
    rules = snakemake.input.rules
    figure_2.write(asked.targets, asked.configfiles, rules, files.svg, files.png, files.csv)
