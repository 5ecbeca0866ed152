"""Draw the correlations of voltages and states: figure 3."""

from eitskin.data import dataset
from eitskin.paper import figure_3
from eitskin.provenance import recorded

with recorded(snakemake):
    files = snakemake.output
    recorded, simulated = map(dataset.read, (snakemake.input.recorded, snakemake.input.simulated))
    figure_3.write(recorded, simulated, files.svg, files.png, files.csv)
