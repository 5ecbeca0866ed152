"""Locate, name and model what the simulation of a recording leaves out."""

from pathlib import Path

from eitskin import recording
from eitskin.diagnose import diagnose
from eitskin.errors import reported

with reported(snakemake.log[0]):
    found = diagnose.diagnose(
        recording.read(snakemake.input.recording), snakemake.params.seed, progress=True
    )
    name, folder = snakemake.wildcards.recording, Path(snakemake.output.diagnosis).parent
    query = snakemake.input.get("query") or None
    diagnose.write(found, name, folder, snakemake.input.schema, query)
