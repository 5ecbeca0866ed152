"""The part of a real recording for a diagnosis: its untouched frames and 5 % of the touches."""

from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import dataset, recording, splits
from eitskin.data.recording import Recording, presses
from eitskin.learn import transfer_runs
from eitskin.simulate.imitation import IMITATED


def write(recorded: Recording, target: dataset.Dataset, folder: str | Path, seed: int) -> None:
    """Write target.parquet, split.parquet and recording.parquet into a folder.

    Whole places are tested; of the others the frames drawn by `labelled` are "train", the remaining
    ones "validation", used without labels. The recording holds the labelled presses and the
    untouched frames, except for those before a tested press; IMITATED are the labelled presses and
    the untouched frames before them.
    """
    folder = Path(folder)
    part = splits.assign(target.table, "place", seed)
    labelled_rows = transfer_runs.labelled(target.table, part, seed)
    part_of_diagnosis = np.where(part == "test", "test", "validation").astype("<U10")
    part_of_diagnosis[labelled_rows] = "train"
    sample = target.table["sample"].to_numpy()
    press = presses(recorded)
    frame = recorded.frames["frame"].to_numpy()
    is_labelled = np.isin(press, press[np.isin(frame, sample[labelled_rows])]) & (press >= 0)
    is_tested = np.isin(press, press[np.isin(frame, sample[part == "test"])]) & (press >= 0)
    next_press = pd.Series(np.where(press >= 0, press, np.nan)).bfill().to_numpy()
    precedes_tested = np.isin(next_press, press[is_tested])
    is_shown = is_labelled | ((press < 0) & ~precedes_tested)
    is_imitated = is_labelled | ((press < 0) & np.isin(next_press, press[is_labelled]))
    frames = recorded.frames.assign(**{IMITATED: is_imitated})[is_shown].reset_index(drop=True)
    frames["frame"] = np.arange(len(frames), dtype=np.int64)
    shown_recording = Recording(frames, recorded.readings[is_shown], None, None, recorded.metadata)
    recording.write(shown_recording, folder / "recording.parquet")
    dataset.write(target, folder / "target.parquet")
    splits.write(folder / "split.parquet", target.table, part_of_diagnosis)
