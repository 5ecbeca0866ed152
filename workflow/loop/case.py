"""Recordings with a concealed effect, with labels to diagnose by and frames to be tested on."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import dataset, recording, splits
from eitskin.data.recording import Recording
from loop.alike import alike
from loop.naming import name_of
from loop.sources import truth
from witness import cases


def write(
    kind: str,
    seed: int,
    folder: str | Path,
    frames: int,
    tested: int,
    share: float,
    forces: dict,
    probe_mm: float,
) -> None:
    """Draw a case and write recording.parquet, what the diagnosis is given; target.parquet, the
    changes of its touches (session 0) and of at least `tested` more of the same world, pressed
    alike; split.parquet, where the recording is "train", the rest "test"; truth.json.

    kind, seed, frames, share: as `witness.cases.draw`; forces, probe_mm: as `alike`.
    """
    folder = Path(folder)
    case = cases.draw(kind, seed, frames, share=share)
    recorded = case.recorded
    told = {
        "kind": kind,
        "seed": seed,
        "effects": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "level": case.level,
        "true": case.true.metadata(),
    }
    rng = np.random.default_rng([seed, 6])
    sessions = int(np.ceil(tested / case.states["touch"].sum()))
    states = alike(recorded, sessions, rng, forces, probe_mm)
    voltage = truth(told, recorded).readings(states, recorded, seed)
    voltage += case.noise_V * rng.standard_normal(voltage.shape)
    both = pd.concat([case.states.assign(session="recording"), states], ignore_index=True)
    both["frame"] = np.arange(len(both), dtype=np.int64)
    whole = Recording(both, np.vstack([case.voltage, voltage]), None, None, case.metadata)
    target = dataset.from_recording(whole, name_of(kind, seed))
    part = np.where(target.table["session"] == 0, "train", "test")
    recording.write(recorded, folder / "recording.parquet")
    dataset.write(target, folder / "target.parquet")
    splits.write(folder / "split.parquet", target.table, part)
    with atomic_path(folder / "truth.json") as path:
        path.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
