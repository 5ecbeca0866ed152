"""What of a real recording a diagnosis may see: its untouched frames and 5 % of the touches."""

from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import dataset, recording, splits
from eitskin.data.recording import Recording, presses
from eitskin.learn import transfer_runs
from loop.alike import IMITATED


def write(recorded: Recording, target: dataset.Dataset, folder: str | Path, seed: int) -> None:
    """Write target.parquet, split.parquet and recording.parquet into a folder.

    Whole places are tested; of the others the frames that `labelled` draws are "train",
    the rest "validation", known without labels. The recording keeps the labelled presses and the
    untouched frames, those apart that precede a tested press; IMITATED are the labelled presses and
    the untouched frames before them.
    """
    folder = Path(folder)
    part = splits.assign(target.table, "place", seed)
    few = transfer_runs.labelled(target.table, part, seed)
    known = np.where(part == "test", "test", "validation").astype("<U10")
    known[few] = "train"
    sample = target.table["sample"].to_numpy()
    press = presses(recorded)
    frame = recorded.frames["frame"].to_numpy()
    labelled = np.isin(press, press[np.isin(frame, sample[few])]) & (press >= 0)
    tested = np.isin(press, press[np.isin(frame, sample[part == "test"])]) & (press >= 0)
    following = pd.Series(np.where(press >= 0, press, np.nan)).bfill().to_numpy()
    spared = np.isin(following, press[tested])
    kept = labelled | ((press < 0) & ~spared)
    imitated = labelled | ((press < 0) & np.isin(following, press[labelled]))
    frames = recorded.frames.assign(**{IMITATED: imitated})[kept].reset_index(drop=True)
    frames["frame"] = np.arange(len(frames), dtype=np.int64)
    seen = Recording(frames, recorded.readings[kept], None, None, recorded.metadata)
    recording.write(seen, folder / "recording.parquet")
    dataset.write(target, folder / "target.parquet")
    splits.write(folder / "split.parquet", target.table, known)
