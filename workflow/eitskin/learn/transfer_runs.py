"""Runs of a transfer from simulation to recording: the methods, the labels that they may see, and
the table of errors that each leaves."""

import numpy as np
import pandas as pd

SHARE = 0.05  # of the recording's training frames, labelled
DRAWS = 10  # of the labelled presses

NONE, FEW, ALL = "none", "5 %", "training part"
ZERO_SHOT = "zero-shot"
CONSTANT, NEAREST = "constant", "nearest of the 5 %"
TRAINED_FEW, TRAINED_ALL = "trained on the 5 %", "trained on the recording"
METHODS = {  # and the recording's labels that each uses
    ZERO_SHOT: NONE,
    "z-score": NONE,
    "CORAL": NONE,
    "affine": FEW,
    "isotonic": FEW,
    "CORAL + adapter": FEW,
    "CORAL + adapter + isotonic": FEW,
    CONSTANT: FEW,
    NEAREST: FEW,
    TRAINED_FEW: FEW,
    TRAINED_ALL: ALL,
}
RUNS = ("method", "draw", "seed", "labelled_frames", "variable", "metric", "value", "left_out")


def labelled(table: pd.DataFrame, part: np.ndarray, seed: int) -> np.ndarray:
    """Rows (n,) of the training part whose labels are known: whole presses (a place in a session),
    drawn until they come nearest to 5 % of its frames; two at least."""
    rows = np.flatnonzero(part == "train")
    press = presses(table, rows)
    drawn = np.random.default_rng(seed).permutation(press.max() + 1)
    frames = np.cumsum(np.bincount(press)[drawn])
    count = max(2, int(np.abs(frames - SHARE * len(rows)).argmin()) + 1)
    return rows[np.isin(press, drawn[:count])]


def presses(table: pd.DataFrame, rows: np.ndarray) -> np.ndarray:
    """(n,): the press, a place in a session, of each of some rows, counted from 0."""
    return table.iloc[rows].groupby(["session", "place"], sort=True).ngroup().to_numpy()
