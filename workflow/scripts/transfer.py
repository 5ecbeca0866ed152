"""Collect the table of transfers."""

from pathlib import Path

from eitskin.errors import reported
from eitskin.paper import transfer_table

with reported(snakemake.log[0]):
    files = []
    for path in map(Path, snakemake.input):
        budget, model, source = path.parts[-4:-1]
        source = "" if source == "references" else source
        keys = {"source": source, "target": path.stem, "model": model, "budget": budget}
        files.append((keys, path))
    transfer_table.write(files, snakemake.output.csv, snakemake.output.markdown)
