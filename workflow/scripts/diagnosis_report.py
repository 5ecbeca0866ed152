"""Write the report of a diagnosis and its figures."""

from pathlib import Path

from eitskin.diagnose import report
from eitskin.errors import reported

with reported(snakemake.log[0]):
    files = snakemake.input
    folder = Path(files.diagnosis).parent
    report.write(folder, files.recording, files.schema, snakemake.output.html)
