"""Draw the workflow: figure 2."""

from eitskin.errors import reported
from eitskin.paper import figure_2

with reported(snakemake.log[0]):
    files, asked = snakemake.output, snakemake.params
    rules = snakemake.input.rules
    figure_2.write(asked.targets, asked.configfiles, rules, files.svg, files.png, files.csv)
