"""Frames that are exact copies of earlier ones: an instrument or a file repeats itself."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording

MAX_CHANCE = 1e-6  # that a coarse converter gives two frames of one state all the same readings


def copies(recording: Recording) -> np.ndarray:
    """Rows (C,) of frames whose readings are all those of an earlier frame.

    None where a coarse converter, or no noise at all, makes equal frames of one state usual: by
    the share of equal readings in successive frames that are no copies.
    """
    values = recording.readings
    is_read = np.isfinite(values).any(axis=1)
    is_copy = pd.Series([hash(frame.tobytes()) for frame in values]).duplicated().to_numpy()
    is_copy = is_copy & is_read & (np.nan_to_num(values) != 0).any(axis=1)
    rows = np.flatnonzero(~is_copy & is_read)
    if not is_copy.any() or len(rows) < 2:
        return np.flatnonzero(is_copy)[:0]
    is_equal = values[rows[1:]] == values[rows[:-1]]
    equal_share = np.quantile(is_equal.mean(axis=1), 0.9)
    if equal_share ** values.shape[1] > MAX_CHANCE:
        return np.flatnonzero(is_copy)[:0]
    return np.flatnonzero(is_copy)
