"""Write the part of a real recording with few labels that a diagnosis uses."""

from pathlib import Path

from eitskin.data import dataset, recording
from eitskin.provenance import recorded
from loop import labelled

with recorded(snakemake):
    files = snakemake.input
    sides = (recording.read(files.recording), dataset.read(files.target))
    labelled.write(*sides, Path(snakemake.output.recording).parent, snakemake.params.seed)
