"""Locate, name and model what the simulation of a recording leaves out."""

from pathlib import Path

from eitskin.data import recording
from eitskin.diagnose import files, parts
from eitskin.diagnose.verdict.record import read_query, record
from eitskin.errors import named
from eitskin.provenance import recorded

with recorded(snakemake):
    recorded = recording.read(snakemake.input.recording)
    path = snakemake.input.get("query")
    query = None if path is None else read_query(path, recorded)
    memory_GiB = snakemake.resources.mem_mb / 1024
    with named(snakemake.input.recording):
        diagnosis = parts.diagnose(recorded, snakemake.params.seed, True, memory_GiB)
    folder = Path(snakemake.output.diagnosis).parent
    files.write(
        record(diagnosis, snakemake.params.name, query), folder, snakemake.input.schema, path
    )
