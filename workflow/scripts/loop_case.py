"""A skin whose owner does not know all: recorded, and touched more often to test on."""

from pathlib import Path

from eitskin.errors import reported
from loop import case

with reported(snakemake.log[0]):
    params = snakemake.params
    folder = Path(snakemake.output.recording).parent
    case.write(*params.drawn, folder, **params.size, forces=params.forces, probe_mm=params.probe_mm)
