"""Write the page of a comparison."""

import json
from pathlib import Path

from eitskin.diagnose.report import comparison_page
from eitskin.errors import reported

with reported(snakemake.log[0]):
    said = json.loads(Path(snakemake.input[0]).read_text(encoding="utf-8"))
    comparison_page.write(said, snakemake.output[0])
