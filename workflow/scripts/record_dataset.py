"""Make a training set of a recording's touches."""

from eitskin.data import dataset, recording
from eitskin.provenance import recorded

with recorded(snakemake):
    source = recording.read(snakemake.input.recording)
    touches = dataset.from_recording(source, snakemake.wildcards.recording)
    dataset.write(touches, snakemake.output[0])
