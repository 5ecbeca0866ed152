"""Whether values are what the file states: absolute, or differences from the untouched skin.

Touches change absolute readings by a part of them: where readings of the untouched skin are smaller
than the changes, all are differences. Noise is the same for all readings or grows with them; where
it is larger for smaller readings, and so are the changes, they were divided by these. Changes alone
do not tell: near the electrodes some skins are stiff.
"""

import numpy as np

from eitskin.data import alignment
from eitskin.data.recording import Recording

MIN_TOUCHED, MIN_UNTOUCHED, MIN_CHANNELS = 5, 5, 20
MAX_SLOPE = -0.3  # of log size over log reading: -0.3 to -1 where normalised, noise else 0 to 0.5


def is_difference(recording: Recording) -> bool:
    """Whether values stated as absolute are differences: touched, the median channel reads far more
    than untouched, and than its noise."""
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    if recording.metadata["values"] != "absolute" or recording.metadata["voltage"] != "signed":
        return False
    if touch.sum() < MIN_TOUCHED or not (~touch).any():
        return False
    untouched = _column_median(recording.readings[~touch])
    noise = _column_median(np.abs(recording.readings[~touch] - untouched))
    level = np.maximum(np.abs(untouched), noise)
    change = _column_median(np.abs(recording.readings[touch]))
    is_read = np.isfinite(level) & np.isfinite(change)
    return bool(is_read.any() and np.median(change[is_read]) > 2.0 * np.median(level[is_read]))


def is_normalised(recording: Recording) -> bool:
    """Whether values stated as differences were divided by the untouched readings; False without
    untouched frames, which tell the noise."""
    touch = recording.frames["touch"].to_numpy(dtype=bool)
    untouched = recording.readings[~touch]
    if recording.metadata["values"] != "difference" or recording.skin.electrode_deg is None:
        return False
    if touch.sum() < MIN_TOUCHED or len(untouched) < MIN_UNTOUCHED:
        return False
    noise = _column_median(np.abs(np.diff(untouched, axis=0)))
    change = _column_median(np.abs(recording.readings[touch]))
    return _slope(recording, noise) < MAX_SLOPE and _slope(recording, change) < MAX_SLOPE


def _slope(recording: Recording, size: np.ndarray) -> float:
    """Slope of log `size` (M,) over log readings of a homogeneous disc; 0 for few channels."""
    disc = alignment.homogeneous_readings(
        recording.channels, np.array(recording.skin.electrode_deg)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        level, change = np.log(np.abs(disc)), np.log(size)
    is_usable = np.isfinite(level) & np.isfinite(change)
    if is_usable.sum() < MIN_CHANNELS or np.ptp(level[is_usable]) < 1e-6:
        return 0.0
    return float(np.polyfit(level[is_usable], change[is_usable], 1)[0])


def _column_median(values: np.ndarray) -> np.ndarray:
    """(M,): the median of each column, NaN for one without readings."""
    medians = np.full(values.shape[1], np.nan)
    has_readings = np.isfinite(values).any(axis=0)
    medians[has_readings] = np.nanmedian(values[:, has_readings], axis=0)
    return medians
