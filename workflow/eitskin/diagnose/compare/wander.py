"""Wander: how far a skin's readings differ between two sessions without a fault.

In units of each channel's white noise, the means of blocks of frames scatter along a few directions
(drying, warming and settling move many channels at once) and, across these, a little in every
channel. The difference of two sessions scatters alike, by an unknown factor: along the directions
and along a common gain it may have any size, across them it is as large as the scatter within the
sessions or larger. Constants without a source were set on pairs of real and simulated sessions, the
development block of docs/concealed/pairs.md.
"""

import math
from dataclasses import dataclass

import numpy as np

from eitskin.data.check.measures import NORMAL, successive_noise

BLOCK_FRAMES = 5  # whose mean is one sample of the wander
MOST_BLOCKS = 16  # of a session
RELATIVE_FLOOR = 1e-6  # of a reading: its noise where repeats are equal
SPIKE = 5.0  # sd from a session's median, beyond which a reading is clipped to it
JUMP = 8.0  # white sd; beyond it a step is none of white noise
LOUD = 0.2  # share of the channels that step in a loud frame
EDGE = 1.5  # times the largest singular value of white noise: a direction beyond it is coherent
POOLING_DOF = 4.0  # for which the mean of all channels counts in the variance of each
WALK = 4.0  # variance of a random walk between the means of two sessions, over that within one
MOST_CORRELATED = 0.95  # weight of the sample covariance; 1 would make it singular
FEWEST_ROBUST = 8  # steps: the median of fewer is worth less than their mean square
MOST_PRIOR_DOF = 20.0  # of the scale between sessions, from the scatter within them
SINGULAR = 1e-9  # of the largest eigenvalue: an eigenvalue below it is rounding


@dataclass(frozen=True)
class Wander:
    """The mean change between two sessions, and its scale without a fault.

    usable (M,) bool: channels read in both; mean (M,), change (M,), V: of the control, and from it
    to the later session; noise (M,), V: sd of a frame's white noise; scale (M,), V: sd of the
    wander of `change`; nuisance (M, q): orthonormal, in units of `scale`, along which a skin
    changes by any amount; correlated (M, s), shrinkage (s,): orthonormal directions in which
    channels scatter together, and the sd of independent channels over that along them; prior_dof:
    degrees of freedom of the scale. Channels that are not usable have 0, an infinite scale.
    """

    usable: np.ndarray
    mean: np.ndarray
    change: np.ndarray
    noise: np.ndarray
    scale: np.ndarray
    nuisance: np.ndarray
    correlated: np.ndarray
    shrinkage: np.ndarray
    prior_dof: float

    @property
    def dof(self) -> int:
        """Degrees of freedom of the change across the nuisance."""
        return int(self.usable.sum()) - self.nuisance.shape[1]

    @property
    def relative_rms(self) -> float:
        """Rms of the change across the nuisance, in units of `scale`; NaN without a degree of
        freedom."""
        if self.dof < 1:
            return math.nan
        return float(np.linalg.norm(self.whitened(self.change)) / np.sqrt(self.dof))

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Values (M,) or (M, k), V, in units of `scale`, decorrelated and across the nuisance."""
        white = values / (self.scale if values.ndim == 1 else self.scale[:, None])
        white = _decorrelated(white, self.correlated, self.shrinkage)
        return white - self.nuisance @ (self.nuisance.T @ white)


def _decorrelated(white: np.ndarray, correlated: np.ndarray, shrinkage: np.ndarray) -> np.ndarray:
    """Values (M,) or (M, k) of unit channels times the inverse root of their covariance."""
    components = correlated.T @ white
    return white - correlated @ ((1.0 - shrinkage) * components.T).T


def wander(control: np.ndarray, later: np.ndarray) -> Wander:
    """The change and its wander from the untouched readings of two sessions.

    control (N, M), later (N', M), V, NaN where lost, one frame or more each. A channel that either
    session lost in more than half of its frames is not usable.
    """
    usable = np.isfinite(control).mean(axis=0) >= 0.5
    usable &= np.isfinite(later).mean(axis=0) >= 0.5
    sessions = [_clipped(readings[:, usable]) for readings in (control, later)]
    mean, later_mean = (session.mean(axis=0) for session in sessions)
    noise, step_count = _white_noise(sessions, mean)
    white = [session / noise for session in sessions]
    scale, directions, samples = _scatter(white)
    scale = np.hypot(scale, _jumps(white))
    scale = scale * noise
    correlated, shrinkage = _correlation(samples)
    columns = np.column_stack([mean / scale, noise[:, None] * directions / scale[:, None]])
    nuisance = np.linalg.qr(_decorrelated(columns, correlated, shrinkage))[0]

    def of_all_channels(values: np.ndarray, fill: float = 0.0) -> np.ndarray:
        padded = np.full((len(usable), *values.shape[1:]), fill)
        padded[usable] = values
        return padded

    return Wander(
        usable,
        of_all_channels(mean),
        of_all_channels(later_mean - mean),
        of_all_channels(noise),
        of_all_channels(scale, np.inf),
        of_all_channels(nuisance),
        of_all_channels(correlated),
        shrinkage,
        min(MOST_PRIOR_DOF, step_count),
    )


def _clipped(readings: np.ndarray) -> np.ndarray:
    """Readings (N, M) with the median in place of lost ones, and spikes clipped."""
    median = np.nanmedian(readings, axis=0)
    sd = NORMAL * np.nanmedian(np.abs(readings - median), axis=0)
    filled = np.where(np.isfinite(readings), readings, median)
    reach = np.where(sd > 0, SPIKE * sd, np.inf)
    return np.clip(filled, median - reach, median + reach)


def _white_noise(sessions: list[np.ndarray], mean: np.ndarray) -> tuple[np.ndarray, int]:
    """Sd (M,) of a frame's noise from steps between neighbouring frames, and the number of steps.

    The fewer steps, the closer to a law: half a constant, half proportional to the reading.
    """
    level = np.abs(mean)
    law = 0.5 * (level + np.median(level[level > 0])) if level.any() else np.ones(len(level))
    steps = np.concatenate([np.diff(session, axis=0) for session in sessions])
    if not len(steps):
        return law, 0
    variance = 0.5 * (steps**2).mean(axis=0)
    if len(steps) >= FEWEST_ROBUST:
        variance = successive_noise(steps) ** 2
    ratio = np.median(variance / law**2) or (variance / law**2).mean() or RELATIVE_FLOOR**2
    weight = len(steps) / (len(steps) + POOLING_DOF)
    return np.sqrt(weight * variance + (1.0 - weight) * ratio * law**2), len(steps)


def _jumps(sessions: list[np.ndarray]) -> np.ndarray:
    """The second largest step (M,) of each channel between neighbouring frames, 0 below JUMP.

    A channel that steps to and fro within a session may step between two; a fault that begins
    steps once. A frame in which many channels step is loud, and is left out.
    """
    steps = np.abs(np.concatenate([np.diff(session, axis=0) for session in sessions]))
    if len(steps) < 2:
        return np.zeros(steps.shape[1])
    steps = steps[(steps > JUMP).mean(axis=1) < LOUD]
    second_largest = np.sort(steps, axis=0)[-2] if len(steps) > 1 else np.zeros(steps.shape[1])
    return np.where(second_largest > JUMP, second_largest, 0.0)


def _block_means(session: np.ndarray) -> np.ndarray:
    """Means (B, M) of blocks of frames, less the mean of the session."""
    count = np.clip(len(session) // BLOCK_FRAMES, 1, MOST_BLOCKS)
    means = np.array([block.mean(axis=0) for block in np.array_split(session, count)])
    return means - means.mean(axis=0)


def _scatter(sessions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sd (M,) of the difference of the sessions' means across coherent directions (M, q), in units
    of white noise, these directions, and samples (s, M) of the scatter across them: each channel's
    squares add to the number of degrees of freedom."""
    white = sum(1.0 / len(session) for session in sessions)
    blocks = np.concatenate([_block_means(session) for session in sessions])
    count, width = blocks.shape
    dof = count - len(sessions)
    if dof < 1:
        return np.full(width, np.sqrt(white)), np.zeros((width, 0)), np.zeros((0, width))
    length = sum(map(len, sessions)) / count
    _, singular_values, rows = np.linalg.svd(blocks, full_matrices=False)
    edge = EDGE * (np.sqrt(dof) + np.sqrt(width)) / np.sqrt(length)
    rank = min(int((singular_values > edge).sum()), min(dof // 2, width // 6))
    directions = rows[:rank].T
    residual = blocks - (blocks @ directions) @ directions.T
    residual_dof = max(dof - rank, 1)
    variance = (residual**2).sum(axis=0) / residual_dof
    variance = (residual_dof * variance + POOLING_DOF * variance.mean()) / (
        residual_dof + POOLING_DOF
    )
    walk = WALK * np.maximum(variance - 1.0 / length, 0.0)
    sd = np.sqrt(variance * residual_dof / len(residual))
    return np.sqrt(walk + white), directions, residual / np.where(sd > 0, sd, 1.0)


def _correlation(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (M, s) in which channels scatter together, from samples (s, M), and the sd (s,) of
    independent channels over that along them.

    The covariance is shrunk towards independent channels (Ledoit & Wolf 2004).
    """
    count, width = samples.shape
    if count < 2:
        return np.zeros((width, 0)), np.zeros(0)
    gram = samples @ samples.T / count
    square = (gram**2).sum() / width
    excess = square - 1.0
    sampling_variance = (np.diag(gram) ** 2).sum() / width - square / count
    weight = (
        float(np.clip(1.0 - sampling_variance / excess, 0.0, MOST_CORRELATED))
        if excess > 0
        else 0.0
    )
    eigenvalues, rows = np.linalg.eigh(gram)
    positive = eigenvalues > SINGULAR * eigenvalues.max()
    directions = samples.T @ rows[:, positive] / np.sqrt(count * eigenvalues[positive])
    return directions, np.sqrt((1.0 - weight) / (1.0 - weight + weight * eigenvalues[positive]))
