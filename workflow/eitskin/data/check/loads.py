"""Load cells that lost their signal, for forces fall away while the readings say that the probe
still presses; and load cells whose zero is off, for they report a force where nobody touches."""

from dataclasses import dataclass

import numpy as np

from eitskin.data import baseline
from eitskin.data.check.measures import reading_variance
from eitskin.data.recording import UNTOUCHED_FORCE, Recording, presses
from eitskin.errors import InputError

MAX_FORCE_SHARE = 0.1  # of the press's force before, to which the force falls
MIN_CHANGE_SHARE = 0.6  # of the change before: a contact law F^0.5 leaves a third of it
MIN_FRAMES = 3  # of a press
MIN_CHANGE_SD = 5.0  # of the change along the press's own, by noise
LEAST_ZERO_N, ZERO_SDS = 0.02, 3.0  # off 0 in newtons, and in standard errors of the mean
LEAST_WANDER_N = 0.1  # of half of the frames: what a gel that recovers holds is less


def lost_forces(recording: Recording) -> np.ndarray:
    """Rows of touched frames whose force is at most MAX_FORCE_SHARE of the last usual one of their
    press, though the readings change by MIN_CHANGE_SHARE of what they did then.

    None where forces are unknown.
    """
    try:
        change = np.nan_to_num(baseline.steady_changes(recording, "recording"))
    except InputError:  # a session without an untouched frame
        return np.zeros(0, int)
    force = recording.frames["force_N"].to_numpy(float)
    press = presses(recording)
    variance = reading_variance(recording)
    lost_rows: list[int] = []
    touched = np.flatnonzero(press >= 0)
    order = touched[np.argsort(press[touched], kind="stable")]
    for rows in np.split(order, np.flatnonzero(np.diff(press[order])) + 1):
        if len(rows) < MIN_FRAMES or not np.isfinite(force[rows]).all():
            continue
        pattern = change[rows[np.argmax(force[rows])]]
        pattern = pattern / (np.linalg.norm(pattern) or 1.0)
        amplitude = change[rows] @ pattern
        noise_limit = MIN_CHANGE_SD * np.sqrt(pattern**2 @ variance)
        usual = 0
        for k in range(1, len(rows)):
            has_fallen = force[rows[k]] <= MAX_FORCE_SHARE * force[rows[usual]]
            if not has_fallen:
                usual = k
            elif amplitude[k] > max(noise_limit, MIN_CHANGE_SHARE * amplitude[usual]):
                lost_rows.append(int(rows[k]))
    return np.array(sorted(lost_rows), int)


@dataclass(frozen=True)
class LoadCellZero:
    """Force that a load cell reports of an untouched skin: the median of some frames, the least and
    the largest, in N; `wanders` where it changes in the session, not by noise."""

    median_N: float
    least_N: float
    largest_N: float
    frames: int
    wanders: bool


def load_cell_zero(recording: Recording) -> LoadCellZero | None:
    """The zero of a load cell where it is off; None where it is not, or nobody says."""
    if UNTOUCHED_FORCE not in recording.frames:
        return None
    force = recording.frames[UNTOUCHED_FORCE].dropna().to_numpy(float)
    median = float(np.median(force)) if len(force) else 0.0
    error = float(force.std() / np.sqrt(len(force))) if len(force) else 0.0
    wanders = _wanders(force)
    if abs(median) < max(LEAST_ZERO_N, ZERO_SDS * error) and not wanders:
        return None
    return LoadCellZero(median, float(force.min()), float(force.max()), len(force), wanders)


def _wanders(force: np.ndarray) -> bool:
    """Whether forces (U,) in their order change from frame to frame less than their spread tells,
    by the von Neumann ratio."""
    if len(force) < baseline.MIN_NOISE_FRAMES:
        return False
    is_smooth = (np.diff(force) ** 2).mean() < baseline.MAX_NEUMANN * force.var()
    spread = np.subtract(*np.quantile(force, [0.75, 0.25]))
    return bool(is_smooth and spread > LEAST_WANDER_N)
