"""Recordings with a concealed effect, with labels for the diagnosis and frames for the test."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import dataset, recording, splits
from eitskin.data.recording import Recording
from eitskin.simulate.imitation import PressPrior, imitated_presses
from loop.naming import name_of
from loop.sources import truth
from witness import cases


@dataclass(frozen=True)
class Size:
    """The size of a case: `frames` of the recording and the `share` of the misfit, as in
    `witness.cases.draw`, and the least number of `tested` touches."""

    frames: int
    tested: int
    share: float


def write(kind: str, seed: int, folder: str | Path, size: Size, prior: PressPrior) -> None:
    """Draw a case, of a kind and seed of `witness.cases.draw`, and write into the folder:
    recording.parquet, the input of the diagnosis; target.parquet, the changes of its touches
    (session 0) and of imitated ones in the same world; split.parquet, with the recording as "train"
    and the others as "test"; truth.json."""
    folder = Path(folder)
    case = cases.draw(kind, seed, size.frames, share=size.share)
    recorded = case.recorded
    description = {
        "kind": kind,
        "seed": seed,
        "effects": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "level": case.level,
        "true": case.true.metadata(),
    }
    rng = np.random.default_rng([seed, 6])
    sessions = int(np.ceil(size.tested / case.states["touch"].sum()))
    states = imitated_presses(recorded, sessions, rng, prior)
    voltage = truth(description, recorded).readings(states, recorded, seed)
    voltage += case.noise_V * rng.standard_normal(voltage.shape)
    frames_table = pd.concat([case.states.assign(session="recording"), states], ignore_index=True)
    frames_table["frame"] = np.arange(len(frames_table), dtype=np.int64)
    touches = Recording(frames_table, np.vstack([case.voltage, voltage]), None, None, case.metadata)
    target = dataset.from_recording(touches, name_of(kind, seed))
    part = np.where(target.table["session"] == 0, "train", "test")
    recording.write(recorded, folder / "recording.parquet")
    dataset.write(target, folder / "target.parquet")
    splits.write(folder / "split.parquet", target.table, part)
    with atomic_path(folder / "truth.json") as path:
        path.write_text(json.dumps(description, indent=1) + "\n", encoding="utf-8")
