"""The shipped sample as a picture: residual, sentence, corrected fit, truth.

    python -m proof.sample_figure docs/sample docs/sample/picture

The diagnosis is given the recording alone; the truth is read after it.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from eitskin import figure_files
from eitskin.data import recording
from eitskin.diagnose import diagnosis, files
from eitskin.diagnose.fitting.query import predict
from eitskin.diagnose.report import evidence
from eitskin.diagnose.verdict.record import read_query, record
from proof import case_figure


def write(folder: Path, out: Path) -> None:
    """OUT.svg and OUT.png, and the error on hidden frames as OUT.csv, of a folder that
    `witness.sample` wrote."""
    path = folder / "recording.parquet"
    recorded = recording.read(path)
    query = read_query(folder / "query.parquet", recorded)
    diagnosed = diagnosis.diagnose(recorded, progress=True)
    with tempfile.TemporaryDirectory() as verdict:
        files.write(record(diagnosed, "sample"), verdict, files.SCHEMA)
        shown = evidence.read(Path(verdict), path, files.SCHEMA)
    predictions = {
        "before": predict(diagnosed.baseline.fit, diagnosed.recording, query)[0],
        "after": predict(diagnosed.explanation.fit, diagnosed.recording, query)[0],
    }
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    clean, noise = (np.array(truth[key]) for key in ("query_voltage_V", "noise_V"))
    frames = case_figure.errors(query.frames, predictions, clean, noise)
    suffixes = (out.with_suffix(f".{suffix}") for suffix in ("svg", "png", "csv"))
    figure_files.write(case_figure.picture(shown, frames, truth), frames, *suffixes)


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]))
