"""Whether readings change at all, and whether they change where the skin is touched."""

from dataclasses import dataclass

import numpy as np

from eitskin.data import baseline
from eitskin.data.check.finding import ERROR, WARNING
from eitskin.data.recording import Recording
from eitskin.errors import InputError

MIN_FRAMES = 3  # two may be equal within a converter's step
MIN_FRAMES_EACH = 8  # untouched and touched, for a rank test at MAX_P_VALUE
MAX_P_VALUE = 0.01  # of the rank test: below, touches are seen


@dataclass(frozen=True)
class ConstantFrames:
    """Number of equal frames, and of the touched ones among them."""

    frames: int
    touched: int

    @property
    def severity(self) -> str:
        """A warning only where the skin is untouched: one frame still has information."""
        return ERROR if self.touched else WARNING


def constant_frames(recording: Recording) -> ConstantFrames | None:
    """Frames in which no reading ever changes; None where one does, or frames are too few."""
    values = recording.readings
    if len(values) < MIN_FRAMES:
        return None
    is_read = np.isfinite(values)
    is_repeated = is_read.sum(axis=0) > 1
    changes = np.fmax.reduce(values, axis=0) > np.fmin.reduce(values, axis=0)
    if not is_repeated.any() or changes.any():
        return None
    return ConstantFrames(len(values), int(recording.frames["touch"].sum()))


@dataclass(frozen=True)
class UnseenTouches:
    """Numbers of touched and untouched frames with changes of the same size, and the one-sided
    p-value of their difference (Mann-Whitney)."""

    touched: int
    untouched: int
    p_value: float


def unseen_touches(recording: Recording) -> UnseenTouches | None:
    """Touches that change no reading; None where they do, or frames are too few to decide."""
    if recording.metadata["values"] == "difference":
        return None
    try:
        change = baseline.steady_changes(recording, "recording")
    except InputError:  # a session without an untouched frame
        return None
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    is_read = np.isfinite(change)
    is_measured = is_read[~touch].sum(axis=0) >= MIN_FRAMES_EACH
    change, is_read = np.where(is_read, change, 0.0)[:, is_measured], is_read[:, is_measured]
    power = (change[~touch] ** 2).sum(axis=0) / np.maximum(is_read[~touch].sum(axis=0), 1)
    is_live = power > 0
    if not is_live.any():
        return None
    scaled_power = (change[:, is_live] ** 2 / power[is_live]).sum(axis=1)
    mean_power = scaled_power / np.maximum(is_read[:, is_live].sum(axis=1), 1)
    has_readings = is_read[:, is_live].any(axis=1)
    untouched_power, touched_power = (
        mean_power[~touch & has_readings],
        mean_power[touch & has_readings],
    )
    if min(len(untouched_power), len(touched_power)) < MIN_FRAMES_EACH:
        return None
    from scipy.stats import mannwhitneyu  # here, as every start of the workflow would load it

    p_value = float(mannwhitneyu(touched_power, untouched_power, alternative="greater").pvalue)
    return (
        UnseenTouches(len(touched_power), len(untouched_power), p_value)
        if p_value > MAX_P_VALUE
        else None
    )
