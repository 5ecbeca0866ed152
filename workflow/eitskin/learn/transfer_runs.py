"""Runs of a transfer from simulation to recording: the methods, the labels they use, and the
columns of their errors."""

import numpy as np
import pandas as pd

SHARE = 0.05  # of the recording's training frames that are labelled: the authors'
DRAWS = 10  # of the labelled presses, for an interval over them

NO_LABELS, FEW_LABELS, ALL_LABELS = "none", "5 %", "training part"
ZERO_SHOT = "zero-shot"
CONSTANT, NEAREST = "constant", "nearest of the 5 %"
TRAINED_FEW, TRAINED_ALL = "trained on the 5 %", "trained on the recording"
METHODS = {  # and the recording's labels that each uses
    ZERO_SHOT: NO_LABELS,
    "z-score": NO_LABELS,
    "CORAL": NO_LABELS,
    "affine": FEW_LABELS,
    "isotonic": FEW_LABELS,
    "CORAL + adapter": FEW_LABELS,
    "CORAL + adapter + isotonic": FEW_LABELS,
    CONSTANT: FEW_LABELS,
    NEAREST: FEW_LABELS,
    TRAINED_FEW: FEW_LABELS,
    TRAINED_ALL: ALL_LABELS,
}
RUNS = ("method", "draw", "seed", "labelled_frames", "variable", "metric", "value", "left_out")


def labelled(table: pd.DataFrame, part: np.ndarray, seed: int) -> np.ndarray:
    """Labelled rows (n,) of the training part: whole presses (a place in a session), drawn at
    random until they are nearest to 5 % of its frames; at least two."""
    rows = np.flatnonzero(part == "train")
    press = presses(table, rows)
    shuffled_presses = np.random.default_rng(seed).permutation(press.max() + 1)
    frames = np.cumsum(np.bincount(press)[shuffled_presses])
    count = max(2, int(np.abs(frames - SHARE * len(rows)).argmin()) + 1)
    return rows[np.isin(press, shuffled_presses[:count])]


def presses(table: pd.DataFrame, rows: np.ndarray) -> np.ndarray:
    """(n,): the number of the press, a place in a session, of each row, from 0."""
    return table.iloc[rows].groupby(["session", "place"], sort=True).ngroup().to_numpy()
