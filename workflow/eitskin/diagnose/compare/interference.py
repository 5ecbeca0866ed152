"""The mains in the noise of frames, and a converter's limit in their largest readings."""

import numpy as np

from eitskin.diagnose.compare.faults import TONES_HZ

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
    it is larger, the powers being exponential and their means told by medians, which a frame of
    another state does not move; 0 where either has fewer than three."""
    first, second = len(control), len(later)
    if min(first, second) < 3:
        return np.zeros(control.shape[1])
    a, b = (np.median(each, axis=0) / np.log(2.0) for each in (control, later))
    both = (first * a + second * b) / (first + second)
    with np.errstate(divide="ignore"):
        nats = (first + second) * np.log(both) - first * np.log(a) - second * np.log(b)
    return np.where(b > a, nats, 0.0)


def limit(control: np.ndarray, later: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Which channels (M,) reach the largest size of the later readings (N', M), where many have it
    exactly and few of the control's (N, M) theirs; and the nats that these ties are worth. None
    without."""
    before, after = (np.abs(np.nan_to_num(each)) for each in (control, later))
    ties, at_most = ((each == each.max()) for each in (after, before))
    if not after.max() > 0 or ties.sum() < max(TIES, 2 * at_most.sum() + 1):
        return None
    return ties.any(axis=0), NATS_A_TIE * min(int(ties.sum()), MOST_TIES)
