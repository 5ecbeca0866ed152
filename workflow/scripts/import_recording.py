"""Bring a recording, from whatever source, into the recording format."""

from eitskin.data import importers, recording
from eitskin.errors import reported

with reported(snakemake.log[0]):
    imported = importers.load(snakemake.input[0], **snakemake.params.read_as)
    recording.write(imported, snakemake.output[0])
