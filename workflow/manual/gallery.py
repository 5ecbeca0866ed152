"""The gallery: twenty simulated recordings, each as a picture with the sentence that was found.

    python -m manual.gallery docs/gallery

Recordings are drawn by the generator of concealed cases, which shares no line with the simulation
of the diagnosis, all with one seed; the diagnosis is given the recording alone. It takes some ten
minutes; what is there already stays.
"""

import csv
import sys
import tempfile
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis, files
from eitskin.diagnose.report import evidence, figures
from eitskin.diagnose.verdict.opening import opening
from eitskin.diagnose.verdict.record import record
from eitskin.plotting import png, style
from proof.case_figure import truth_words
from witness import cases

SEED, FRAMES = 1, 60
NOTHING = "nothing"
NAMES = (
    NOTHING,
    "electrode-position",
    "electrode-width",
    "contact-impedance",
    "electrode-open",
    "electrode-swap",
    "offset",
    "drive-gain",
    "measurement-gain",
    "channel-gain",
    "ground-leak",
    "common-mode",
    "crosstalk",
    "multiplexer-memory",
    "domain-shape",
    "anisotropy",
    "conductivity-gradient",
    "contact-law",
    "relaxation",
    "registration",
)
COLUMNS = ("name", "hidden", "found")


def concealed(name: str) -> cases.Case:
    """The recording with one effect, or with none."""
    return cases.draw("gallery", SEED, frames=FRAMES, names=[] if name == NOTHING else [name])


def first_sentence(case: cases.Case, picture: Path) -> str:
    """The first sentence of the report on a recording; its picture of the error is written."""
    recorded = Recording(case.states, case.voltage, None, None, case.metadata)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.parquet"
        recording.write(recorded, path)
        diagnosed = diagnosis.diagnose(recording.read(path))
        files.write(record(diagnosed, "gallery"), folder, files.SCHEMA)
        diagnosed_evidence = evidence.read(folder, path, files.SCHEMA)
    with style():
        image = png(figures.hidden_error(diagnosed_evidence))
    with atomic_path(picture) as temporary:
        temporary.write_bytes(image)
    return opening(diagnosed_evidence.diagnosis, diagnosed_evidence.channels)


def write(folder: Path) -> None:
    """NAME.png of every recording and gallery.csv; rows that are there already stay."""
    path = folder / "gallery.csv"
    rows = []
    if path.is_file():
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    known = {row["name"] for row in rows}
    for name in NAMES:
        if name in known:
            continue
        case = concealed(name)
        words = "; ".join(map(truth_words, case.effects)) or NOTHING
        sentence = first_sentence(case, folder / f"{name}.png")
        rows.append({"name": name, "hidden": words, "found": sentence})
        rows.sort(key=lambda row: NAMES.index(row["name"]))
        with (
            atomic_path(path) as temporary,
            temporary.open("w", encoding="utf-8", newline="") as file,
        ):
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        print(f"{name}: {sentence}", flush=True)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
