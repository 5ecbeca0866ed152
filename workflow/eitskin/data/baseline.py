"""The untouched skin: what readings are compared with, and how much they change without a touch."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, voltages
from eitskin.errors import InputError


def changes(recording: Recording, name: str) -> np.ndarray:
    """What changed in each frame (N, M) float64 against the untouched skin; NaN where unknown.

    One rule for every recording: the baseline of a frame is the mean of the run of untouched
    frames last seen before it in its session, or of the next run where none came before. A skin
    measured untouched before every press is thus followed as it drifts; one measured untouched at
    the start alone gets the paper's V_ref (§ II-B). An untouched frame is compared with the run
    before its own, as a touch in its place would be; in a session's first run with the other
    frames of that run. Frames of `values: difference` are changes already.

    Raises InputError for a query and for a session without an untouched frame.
    """
    recorded = voltages(recording, name)
    if recording.metadata["values"] == "difference":
        return recorded
    touched = recording.frames["touch"].to_numpy(bool)
    difference = np.full(recorded.shape, np.nan)
    session_of = sessions(recording.frames)
    for session in np.unique(session_of):
        frames = np.flatnonzero(session_of == session)
        free = ~touched[frames]
        if not free.any():
            raise InputError(name, f"session {session}", "no untouched frame", "at least one")
        voltage = recorded[frames]
        first = free & ~np.concatenate([[False], free[:-1]])
        run = np.cumsum(first) - 1  # of an untouched frame its own, of a touched one the last
        count, total = np.zeros((2, run[-1] + 1, voltage.shape[1]))
        np.add.at(count, run[free], np.isfinite(voltage[free]))
        np.add.at(total, run[free], np.nan_to_num(voltage[free]))
        with np.errstate(invalid="ignore", divide="ignore"):
            baseline = (total / count)[np.maximum(run - free, 0)]
            own = free & (run == 0)
            baseline[own] = (total[0] - voltage[own]) / (count[0] - 1)
        difference[frames] = voltage - np.where(np.isfinite(baseline), baseline, np.nan)
    return difference


def level(recording: Recording, lost: list[int]) -> np.ndarray | None:
    """The mean reading of all untouched frames (M,), without the `lost` channels; None where there
    is none, or changes alone."""
    free = ~recording.frames["touch"].to_numpy(bool)
    if recording.voltage is None or recording.metadata["values"] == "difference":
        return None
    untouched = np.delete(recording.readings[free], lost, axis=1)
    there = np.isfinite(untouched)
    if not there.any(axis=0).all():
        return None
    return np.asarray(np.where(there, untouched, 0.0).sum(axis=0) / there.sum(axis=0))


def sessions(frames: pd.DataFrame) -> np.ndarray:
    """The session of each frame (N,), numbered by first appearance; 0 where none are told."""
    if "session" not in frames:
        return np.zeros(len(frames), dtype=np.int64)
    return pd.factorize(frames["session"])[0].astype(np.int64)


def untouched_noise(difference: np.ndarray) -> dict | None:
    """What the change of an untouched frame looks like, from (U, M) such changes.

    `rms` per channel; `quantile_99`: the `upper_limit` at 99 % of the root mean square of
    change / rms in a frame; `frames`: how many there were. None below 20, or where a channel is
    still.
    """
    difference = difference[np.isfinite(difference).all(axis=1)]
    if len(difference) < 20:
        return None
    rms = np.sqrt((difference**2).mean(axis=0))
    if not (rms > 0).all():
        return None
    size = np.sqrt(((difference / rms) ** 2).mean(axis=1))
    return {
        "rms": rms.tolist(),
        "quantile_99": upper_limit(size, 0.99),
        "frames": len(difference),
    }


def upper_limit(values: np.ndarray, share: float) -> float:
    """The value of (n,) below which a new one falls with probability `share` or more, if drawn
    alike: the ⌈(n + 1) share⌉-th smallest (split conformal), the largest where n is too small.
    """
    rank = min(len(values), int(np.ceil((len(values) + 1) * share)))
    return float(np.sort(values)[rank - 1])
