"""Locate, name and model what the simulation of a recording leaves out."""

from pathlib import Path

from eitskin.data import recording
from eitskin.diagnose import apart
from eitskin.diagnose.verdict import result
from eitskin.errors import named, reported

with reported(snakemake.log[0]):
    recorded = recording.read(snakemake.input.recording)
    query = snakemake.input.get("query")
    if query is not None:
        result.read_query(query, recorded)
    memory_GiB = snakemake.resources.mem_mb / 1024
    with named(snakemake.input.recording):
        found = apart.diagnose(recorded, snakemake.params.seed, True, memory_GiB)
    folder = Path(snakemake.output.diagnosis).parent
    result.write(found, snakemake.params.name, folder, snakemake.input.schema, query)
