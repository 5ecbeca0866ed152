"""Write the page of a comparison."""

import json
from pathlib import Path

from eitskin.diagnose.compare import page
from eitskin.provenance import recorded

with recorded(snakemake):
    comparison = json.loads(Path(snakemake.input[0]).read_text(encoding="utf-8"))
    page.write(comparison, snakemake.output[0])
