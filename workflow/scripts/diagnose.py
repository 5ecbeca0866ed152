"""Locate, name and model what the simulation of a recording leaves out."""

from pathlib import Path

from eitskin import recording
from eitskin.diagnose import diagnose
from eitskin.errors import reported

with reported(snakemake.log[0]):
    recorded = recording.read(snakemake.input.recording)
    query = snakemake.input.get("query")
    if query is not None:
        diagnose.read_query(query, recorded)
    found = diagnose.diagnose(recorded, snakemake.params.seed, progress=True)
    folder = Path(snakemake.output.diagnosis).parent
    diagnose.write(found, snakemake.params.name, folder, snakemake.input.schema, query)
