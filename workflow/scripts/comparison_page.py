"""Write the page of a comparison."""

import json
from pathlib import Path

from eitskin.diagnose.compare import page
from eitskin.errors import reported

with reported(snakemake.log[0]):
    comparison = json.loads(Path(snakemake.input[0]).read_text(encoding="utf-8"))
    page.write(comparison, snakemake.output[0])
