"""The table of the closed loop."""

from pathlib import Path

from eitskin.provenance import recorded
from loop import table

with recorded(snakemake):
    params, files = snakemake.params, snakemake.input
    runs = list(zip(params.runs, files.errors, strict=True))
    folders = {Path(path).parents[1].name: Path(path).parents[1] for path in files.diagnoses}
    table.write(runs, folders, snakemake.output.csv, snakemake.output.markdown)
