"""Change with time alone, or in one press alone, taken out of a misfit: a rig's errors do that."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, presses
from eitskin.diagnose.verdict.atlas import DISCOVERY

PASSING = ("time", "order", "session", "press")  # statistics of the atlas


def is_passing(atlas: pd.DataFrame) -> pd.Series:
    """(R,) bool: rows of an atlas on change with time alone, or in one press alone."""
    return _statistic(atlas).isin(PASSING)


def discovered(atlas: pd.DataFrame) -> pd.DataFrame:
    """Of each such statistic the row of least p-value, where it is a discovery by the covariance
    and without it."""
    rows = atlas[(atlas["q"] < DISCOVERY) & (atlas["free_p"] < DISCOVERY) & is_passing(atlas)]
    return rows.groupby(_statistic(rows), sort=False).first()


def _statistic(atlas: pd.DataFrame) -> pd.Series:
    """(R,) str: the statistics of an atlas without what they are of."""
    return atlas["statistic"].astype(str).str.replace(r":.*", "", regex=True)


def without_passing(recording: Recording, residual: np.ndarray, atlas: pd.DataFrame) -> np.ndarray:
    """A residual (N, M), NaN where lost, less what its atlas discovers: of each channel what is
    linear in time beside touched and untouched level, and the frames of the press that is
    other."""
    rows = discovered(atlas)
    left = residual.copy()
    touched = recording.frames["touch"].to_numpy(bool)
    if {"time", "order"} & {*rows.index}:
        key = "time_s" if "time" in rows.index else "frame"
        course = recording.frames[key].to_numpy(float)
        design = np.column_stack([np.ones(len(touched)), touched, course - course.mean()])
        present = np.isfinite(left)
        for channel in np.flatnonzero(present.any(axis=0)):
            frames = present[:, channel]
            slopes = np.linalg.lstsq(design[frames], left[frames, channel])[0]
            left[frames, channel] -= design[frames, 2] * slopes[2]
    if "press" in rows.index:
        left[presses(recording) == int(rows.loc["press", "site"])] = np.nan
    return left
