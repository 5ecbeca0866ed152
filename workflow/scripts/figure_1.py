"""Draw a frame, a press and its images: figure 1."""

from eitskin import figure_1, recording
from eitskin.errors import reported

with reported(snakemake.log[0]):
    files = snakemake.output
    source = recording.read(snakemake.input[0])
    figure_1.write(source, snakemake.params.recording, files.svg, files.png, files.csv)
