"""Draw the method: figure 2."""

from eitskin.paper import figure_2
from eitskin.provenance import recorded

with recorded(snakemake):
    files = snakemake.output
    figure_2.write(files.svg, files.png, files.csv)
