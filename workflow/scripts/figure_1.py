"""Draw a frame, a press and its images: figure 1."""

from eitskin.data import recording
from eitskin.paper import figure_1
from eitskin.provenance import recorded

with recorded(snakemake):
    files = snakemake.output
    source = recording.read(snakemake.input[0])
    figure_1.write(source, snakemake.params.recording, files.svg, files.png, files.csv)
