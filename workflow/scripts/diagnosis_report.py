"""Write the report of a diagnosis and its figures."""

from pathlib import Path

from eitskin.diagnose.report import page
from eitskin.provenance import recorded

with recorded(snakemake):
    files = snakemake.input
    folder = Path(files.diagnosis).parent
    predicted = files.get("predicted") or None
    page.write(folder, files.recording, files.schema, snakemake.output.html, predicted)
