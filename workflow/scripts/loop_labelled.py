"""What a diagnosis may see of a real recording of which few labels are known."""

from pathlib import Path

from eitskin.data import dataset, recording
from eitskin.errors import reported
from loop import labelled

with reported(snakemake.log[0]):
    files = snakemake.input
    sides = (recording.read(files.recording), dataset.read(files.target))
    labelled.write(*sides, Path(snakemake.output.recording).parent, snakemake.params.seed)
