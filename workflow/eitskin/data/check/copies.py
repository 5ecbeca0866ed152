"""Frames that are exact copies of earlier ones: an instrument or a file repeats itself."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, presses

MAX_CHANCE = 1e-6  # that a coarse converter gives two frames of one state all the same readings


def copies(recording: Recording) -> np.ndarray:
    """Rows (C,) of frames whose readings are all those of an earlier frame.

    Without those of one state, untouched or of one force in one press, where all untouched frames
    are equal, so that no noise is seen; none where a coarse converter makes equal frames usual, by
    the share of equal readings in successive frames that are no copies.
    """
    values = recording.readings
    original = pd.factorize(np.array([hash(frame.tobytes()) for frame in values]))[0]
    original = np.unique(original, return_index=True)[1][original]
    is_copy = original < np.arange(len(values))
    is_copy &= (np.nan_to_num(values) != 0).any(axis=1)
    press = presses(recording)
    if (~is_copy & (press < 0)).sum() == 1:
        force = np.where(press < 0, 0.0, recording.frames["force_N"].to_numpy(float))
        is_copy &= (press != press[original]) | (force != force[original])
    rows = np.flatnonzero(~is_copy)
    if is_copy.any() and len(rows) > 1:
        equal_share = np.quantile((values[rows[1:]] == values[rows[:-1]]).mean(axis=1), 0.9)
        is_copy &= equal_share ** values.shape[1] <= MAX_CHANCE
    return np.flatnonzero(is_copy)
