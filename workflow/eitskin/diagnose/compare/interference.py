"""The mains in the noise of frames, and the limit of a converter in their largest readings."""

import numpy as np

from eitskin.diagnose.compare.faults import TONES_HZ

FEWEST_TIES = 4  # readings at the one largest value; noise makes fewer equal
NATS_A_TIE = 2.0  # cautious: a tie by chance is rarer than e^-2
MOST_TIES = 20  # that count: their 40 nats pass every threshold
FEWEST_FRAMES = 3  # whose median a single frame of another state does not move


def tone_power(frames: np.ndarray, noise: np.ndarray, moment_s: np.ndarray) -> np.ndarray:
    """The power (N, tones) of each frame at the mains' frequencies, relative to white noise.

    frames (N, M), V, of which the session's mean is subtracted; noise (M,), V: sd; moment_s (M,):
    when each channel is read within a frame.
    """
    usable = noise > 0
    deviation = frames[:, usable] - np.nanmean(frames[:, usable], axis=0)
    white = np.nan_to_num(deviation) / noise[usable]
    phasor = np.exp(2j * np.pi * np.outer(moment_s[usable], TONES_HZ))
    return np.abs(white @ phasor) ** 2 / usable.sum()


def tone_nats(control: np.ndarray, later: np.ndarray) -> np.ndarray:
    """The log likelihood ratio (tones,), nats, for a larger mean power in the later recording.

    control (N, tones), later (N', tones): powers, exponentially distributed; their means are
    estimated by medians. 0 where the later mean is not larger, or either has too few frames.
    """
    n_control, n_later = len(control), len(later)
    if min(n_control, n_later) < FEWEST_FRAMES:
        return np.zeros(control.shape[1])
    control_mean, later_mean = (
        np.median(powers, axis=0) / np.log(2.0) for powers in (control, later)
    )
    pooled = (n_control * control_mean + n_later * later_mean) / (n_control + n_later)
    with np.errstate(divide="ignore"):
        nats = (
            (n_control + n_later) * np.log(pooled)
            - n_control * np.log(control_mean)
            - n_later * np.log(later_mean)
        )
    return np.where(later_mean > control_mean, nats, 0.0)


def converter_limit(control: np.ndarray, later: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The channels (M,) bool that reach the largest |reading| of the later recording, and the nats
    that its ties are worth; None where few readings tie or the control's tie as well.

    control (N, M), later (N', M): readings, NaN where lost.
    """
    control_size, later_size = (np.abs(np.nan_to_num(readings)) for readings in (control, later))
    later_ties, control_ties = ((size == size.max()) for size in (later_size, control_size))
    fewest = max(FEWEST_TIES, 2 * control_ties.sum() + 1)
    if not later_size.max() > 0 or later_ties.sum() < fewest:
        return None
    return later_ties.any(axis=0), NATS_A_TIE * min(int(later_ties.sum()), MOST_TIES)
