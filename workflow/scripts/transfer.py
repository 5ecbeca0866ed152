"""Collect the table of transfers."""

from pathlib import Path

from eitskin.paper import transfer_table
from eitskin.provenance import recorded

with recorded(snakemake):
    files = []
    for path in map(Path, snakemake.input.errors):
        budget, model, source = path.parts[-4:-1]
        source = "" if source == "references" else source
        keys = {"source": source, "target": path.stem, "model": model, "budget": budget}
        files.append((keys, path))
    transfer_table.write(files, snakemake.output.csv, snakemake.output.markdown)
