"""Forces that fall away while the readings say that the probe still presses: a load cell that lost
its signal."""

import numpy as np

from eitskin.data import baseline
from eitskin.data.check.measures import reading_variance
from eitskin.data.recording import Recording, presses
from eitskin.errors import InputError

MAX_FORCE_SHARE = 0.1  # of the press's force before, to which the force falls
MIN_CHANGE_SHARE = 0.6  # of the change before: a contact law F^0.5 leaves a third of it
MIN_FRAMES = 3  # of a press
MIN_CHANGE_SD = 5.0  # of the change along the press's own, by noise


def lost_forces(recording: Recording) -> np.ndarray:
    """Rows of touched frames whose force is at most MAX_FORCE_SHARE of the last usual one of their
    press, though the readings change by MIN_CHANGE_SHARE of what they did then.

    None where forces are unknown.
    """
    try:
        change = np.nan_to_num(baseline.changes(recording, "recording"))
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
        least = MIN_CHANGE_SD * np.sqrt(pattern**2 @ variance)
        usual = 0
        for k in range(1, len(rows)):
            has_fallen = force[rows[k]] <= MAX_FORCE_SHARE * force[rows[usual]]
            if not has_fallen:
                usual = k
            elif amplitude[k] > max(least, MIN_CHANGE_SHARE * amplitude[usual]):
                lost_rows.append(int(rows[k]))
    return np.array(sorted(lost_rows), int)
