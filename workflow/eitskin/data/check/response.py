"""Whether readings change at all, and whether they change where the skin is touched."""

from dataclasses import dataclass

import numpy as np

from eitskin.data import baseline
from eitskin.data.check.finding import ERROR, WARNING
from eitskin.data.recording import Recording
from eitskin.errors import InputError

LEAST_FRAMES = 3
LEAST_EACH = 8  # untouched and touched frames, to compare them
UNLIKELY = 0.01


@dataclass(frozen=True)
class Constant:
    """How many frames are all alike, and how many of them are touched."""

    frames: int
    touched: int

    @property
    def severity(self) -> str:
        """Of a skin that nobody touches, one frame is still worth something."""
        return ERROR if self.touched else WARNING


def constant(recording: Recording) -> Constant | None:
    """Frames without a change of any reading; None where some changes, or frames are few."""
    values = recording.readings
    if len(values) < LEAST_FRAMES:
        return None
    known = np.isfinite(values)
    lowest = np.where(known, values, np.inf).min(axis=0)
    highest = np.where(known, values, -np.inf).max(axis=0)
    again = known.sum(axis=0) > 1
    if not again.any() or (highest > lowest).any():
        return None
    return Constant(len(values), int(recording.frames["touch"].sum()))


@dataclass(frozen=True)
class Unseen:
    """How many touched frames change no more than untouched ones do, and the chance of a
    difference like theirs without any touch (Mann-Whitney, one-sided).
    """

    touched: int
    untouched: int
    p_value: float


def unseen(recording: Recording) -> Unseen | None:
    """Touches that no reading shows; None where they show, or frames are too few to say so."""
    if recording.metadata["values"] == "difference":
        return None
    try:
        change = baseline.changes(recording, "recording")
    except InputError:  # a session without an untouched frame
        return None
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    known = np.isfinite(change)
    enough = known[~touch].sum(axis=0) >= LEAST_EACH
    change, known = np.where(known, change, 0.0)[:, enough], known[:, enough]
    power = (change[~touch] ** 2).sum(axis=0) / np.maximum(known[~touch].sum(axis=0), 1)
    live = power > 0
    if not live.any():
        return None
    share = (change[:, live] ** 2 / power[live]).sum(axis=1)
    size = share / np.maximum(known[:, live].sum(axis=1), 1)
    some = known[:, live].any(axis=1)
    free, pressed = size[~touch & some], size[touch & some]
    if min(len(free), len(pressed)) < LEAST_EACH:
        return None
    from scipy.stats import mannwhitneyu  # here, as every start of the workflow would load it

    p_value = float(mannwhitneyu(pressed, free, alternative="greater").pvalue)
    return Unseen(len(pressed), len(free), p_value) if p_value > UNLIKELY else None
