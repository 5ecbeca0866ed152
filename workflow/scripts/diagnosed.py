"""Collect what the diagnosis says of recordings into one table."""

import json
from pathlib import Path

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.provenance import recorded
from proof.diagnosed import row

with recorded(snakemake):
    documents = [json.loads(Path(path).read_text("utf-8")) for path in snakemake.input.diagnoses]
    recordings = [recording.read(path) for path in snakemake.input.recordings]
    with atomic_path(snakemake.output[0]) as path:
        rows = [row(*pair) for pair in zip(documents, recordings, strict=True)]
        pd.DataFrame(rows).to_csv(path, index=False, float_format="%.3g")
