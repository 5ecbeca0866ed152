"""The mains in the noise of frames, and a converter's limit in their largest readings."""

import numpy as np

from eitskin.diagnose.comparison.faults import TONES_HZ

TIES = 4  # readings at one largest value that no noise gives
NATS_A_TIE = 2.0
MOST_TIES = 20


def tone_power(frames: np.ndarray, noise: np.ndarray, moment_s: np.ndarray) -> np.ndarray:
    """Frames (N, M), V, noise (M,): the power of each frame at the mains' frequencies, about the
    session's mean and relative to that of white noise, (N, tones)."""
    known = noise > 0
    about = frames[:, known] - np.nanmean(frames[:, known], axis=0)
    white = np.nan_to_num(about) / noise[known]
    turn = np.exp(2j * np.pi * np.outer(moment_s[known], TONES_HZ))
    return np.abs(white @ turn) ** 2 / known.sum()


def louder(control: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Nats for another mean of the later powers (N', tones) than of the control's (N, tones), where
    it is larger, the powers being exponential about their means; 0 where either has one frame."""
    first, second = len(control), len(later)
    if min(first, second) < 3:
        return np.zeros(control.shape[1])
    a, b = control.mean(axis=0), later.mean(axis=0)
    both = (first * a + second * b) / (first + second)
    with np.errstate(divide="ignore"):
        nats = (first + second) * np.log(both) - first * np.log(a) - second * np.log(b)
    return np.where(b > a, nats, 0.0)


def limit(control: np.ndarray, later: np.ndarray) -> tuple[float, float] | None:
    """The largest size of the later readings (N', M), V, where several have it exactly and the
    control's (N, M) go beyond; and the nats that these ties are worth. None without."""
    size = np.abs(later[np.isfinite(later)])
    largest = float(size.max())
    ties = int((size == largest).sum())
    before = np.abs(control[np.isfinite(control)])
    at_most = int((before == before.max()).sum())
    if ties < TIES or ties < 2 * at_most or not (before > largest).any():
        return None
    return largest, NATS_A_TIE * min(ties, MOST_TIES)
