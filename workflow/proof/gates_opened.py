"""`python -m proof.gates_opened results/gates_opened [NAMES]` measures whether `eitskin explain` is
true: ten drawn recordings are diagnosed, and again with the gate opened at which a name stopped.

The name must then stop at another gate, or be among the effects. NAMES of each recording's refused
names are tried, by lot, by default all; what was tried stays when the command is run again.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.verdict import refusals
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from proof.drawing import draw
from proof.intervals import wilson

KINDS = (  # of what a skin leaves out: nothing, one effect of each stage, two, something unnamed
    "null",
    "null+rig",
    "single:contact-impedance",
    "single:touch-contrast",
    "single:measurement-gain",
    "single:electrode-position",
    "single:force-offset",
    "single:crosstalk",
    "pair",
    "outside:palm",
)
FIXED = ("physics", "signature")  # facts about the readings, which no rule could let pass
COLUMNS = ["recording", "name", "gate", "value", "opened_gate", "opened_value", "moved"]


def trial(recording: Recording, before: Diagnosis, stop: refusals.Stop) -> dict:
    """The row of one refused name: where it stopped, and where it stops with that gate opened, ""
    where it is among the effects then."""
    opened = frozenset({(stop.gate.name, stop.name)})
    after = diagnosis.diagnose(recording, opened=opened)
    names = [candidate.name for candidate in after.explanation.effects]
    end = None
    if stop.name not in names:
        end = refusals.stop(after.search.journal.table(), names, stop.name)
    is_moved = stop.name in names or (end is not None and end.gate.name != stop.gate.name)
    return {
        "name": stop.name,
        "gate": stop.gate.name,
        "value": stop.value,
        "opened_gate": end.gate.name if end is not None else "",
        "opened_value": end.value if end is not None else np.nan,
        "moved": is_moved,
    }


def main(folder: Path, count: int | None = None) -> None:
    """Try refused names of every recording, `count` of each or all; write trials.csv, a row a name,
    and print the share that moved with its 95 % interval."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "trials.csv"
    table = pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=COLUMNS)
    for seed, kind in enumerate(KINDS):
        label = f"{kind} {seed}"
        recording = draw(kind, seed).recorded
        plain = diagnosis.diagnose(recording)
        names = [candidate.name for candidate in plain.explanation.effects]
        stops = refusals.stops(plain.search.journal.table(), names)
        stops = [stop for stop in stops if stop.gate.name not in FIXED]
        order = np.random.default_rng(seed).permutation(len(stops))
        for stop in [stops[i] for i in order][:count]:
            done = (table["recording"] == label) & (table["name"] == stop.name)
            if done.any():
                continue
            row = pd.DataFrame([{"recording": label, **trial(recording, plain, stop)}])
            table = pd.concat([table, row], ignore_index=True)[COLUMNS]
            with atomic_path(path) as temporary:
                table.to_csv(temporary, index=False)
            print(row.to_string(index=False, header=False), flush=True)
    hits = int(table["moved"].sum())
    low, high = wilson(hits, len(table))
    print(f"{hits} of {len(table)} moved on (95 %: {low:.3f} to {high:.3f})")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else None)
