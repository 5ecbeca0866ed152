"""The law of the noise in a single frame, from the odd half of reciprocity.

Each contrast of reciprocal channels holds noise alone, or a difference of drive and measurement,
which is larger: sizes are those of a Student distribution, which outliers move little. Sd of a
reading v is that of s^2 ((1 - w) v^2 + w m^2), m the usual reading: from proportional to the
reading, w = 0, to alike in all channels, w = 1. The law is the mean over w by its posterior, for
few contrasts tell it badly.
"""

from functools import cache

import numpy as np
from scipy.special import expit, logsumexp
from scipy.stats import f, norm

from eitskin.diagnose.noise.noise_model import VarianceLaw
from eitskin.physics.protocol import tied_channels

TAILS = 4.0  # degrees of freedom of the Student distribution
MIXES = expit(np.linspace(-8.0, 8.0, 33))  # w, alike probable beforehand
ROUNDS = 100  # of the scale's fixed point, which converges in some twenty
GAIN_P = 1e-3  # chance of a frame without gains to look as if it had some
LEAST_LEFT = 5  # contrasts, beside the gains: fewer tell no scale
RANK_SHARE = 1e-9  # of the largest singular value: less is rounding
QUANTILES = norm.ppf((np.arange(4000) + 0.5) / 4000)


def single_frame_law(contrasts: np.ndarray, squared_level: np.ndarray) -> tuple[VarianceLaw, float]:
    """The law of the noise by contrasts (P,) of unit combinations of channels, whose mean square
    reading is `squared_level` (P,), and degrees of freedom of its scale, with the law's own
    uncertainty at these levels."""
    usual = float(np.median(squared_level))
    if usual <= 0.0 or len(contrasts) < 2:
        variance = _scale(contrasts[None], np.ones((1, len(contrasts))))
        return VarianceLaw(float(variance[0]), 0.0), _efficiency() * len(contrasts)
    shape = np.outer(1.0 - MIXES, squared_level) + np.outer(MIXES, np.full(len(contrasts), usual))
    scale = _scale(np.tile(contrasts, (len(MIXES), 1)), shape)
    variance = scale[:, None] * shape
    student = variance * _student_scale()
    log_density = -0.5 * np.log(student) - 0.5 * (TAILS + 1.0) * np.log1p(
        contrasts**2 / (TAILS * student)
    )
    log_weight = log_density.sum(axis=1)
    weight = np.exp(log_weight - logsumexp(log_weight))
    law = VarianceLaw(
        float(weight @ (scale * MIXES)) * usual, float(weight @ (scale * (1.0 - MIXES)))
    )
    mean_log = weight @ np.log(variance)
    spread = float((weight @ (np.log(variance) - mean_log) ** 2).mean())
    return law, 2.0 / (2.0 / (_efficiency() * len(contrasts)) + spread)


def beside_gains(values: np.ndarray, channels: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Combinations (K,) of the reciprocal contrasts of a frame (M,) that gains of the drives and
    measuring pairs of its channels (M, 4) leave alone, and their mean square reading (K,).

    Gains differ from drive to drive on every board, and a frame with them has an odd half far above
    its noise. The logarithm of the ratio of two reciprocal readings is linear in those of the
    gains. None where such gains explain no more of it than chance would, by Fisher's F at GAIN_P,
    where they leave fewer than LEAST_LEFT, and where readings do not stand in pairs of one sign.
    """
    group, sign = tied_channels(channels)
    order = np.argsort(group, kind="stable")
    doubles = np.flatnonzero(np.bincount(group) == 2)
    pairs = order[np.searchsorted(group[order], doubles)[:, None] + np.arange(2)]
    first_reading, second_reading = (sign * values)[pairs].T
    if len(pairs) < len(channels) // 2 or not (first_reading * second_reading > 0.0).all():
        return None
    level = np.sqrt(first_reading * second_reading)
    contrasts = level * np.log(first_reading / second_reading) / np.sqrt(2.0)
    sites = np.arange(channels.max() + 1)
    columns = [
        (channels[pairs[:, 0], key][:, None] == sites) * 1.0
        - (channels[pairs[:, 1], key][:, None] == sites)
        for key in (0, 2)
    ]
    directions, sizes, _ = np.linalg.svd(level[:, None] * np.hstack(columns))
    rank = int((sizes > RANK_SHARE * sizes.max(initial=0.0)).sum())
    complement = directions[:, rank:]
    if complement.shape[1] < LEAST_LEFT:
        return None
    combinations = complement.T @ contrasts
    remainder = max(float((combinations**2).mean()), np.finfo(float).tiny)
    explained = float(((directions[:, :rank].T @ contrasts) ** 2).mean())
    if f.sf(explained / remainder, rank, complement.shape[1]) > GAIN_P:
        return None
    return combinations, (complement**2).T @ level**2


def _scale(contrasts: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(W,): factor of variances `shape` (W, P), by contrasts (W, P), consistent for normal ones."""
    ratio = contrasts**2 / shape
    return _fixed_point(ratio) / _student_scale()


def _fixed_point(ratio: np.ndarray) -> np.ndarray:
    """(W,): squared scale of a Student distribution of the greatest likelihood, by squares (W, P)
    of its values."""
    scale = np.maximum(np.median(ratio, axis=-1), np.finfo(float).tiny)
    for _ in range(ROUNDS):
        weight = (TAILS + 1.0) / (TAILS + ratio / scale[..., None])
        scale = np.maximum((weight * ratio).mean(axis=-1), np.finfo(float).tiny)
    return scale


@cache
def _student_scale() -> float:
    """The squared scale that a Student distribution gets of unit normal values."""
    return float(_fixed_point(QUANTILES[None] ** 2)[0])


@cache
def _efficiency() -> float:
    """Of the scale for normal values, beside the variance: its degrees of freedom a value."""
    ratio = QUANTILES**2 / _student_scale()
    score = (TAILS + 1.0) * ratio / (TAILS + ratio) - 1.0
    slope = (TAILS + 1.0) * TAILS * ratio / (TAILS + ratio) ** 2
    return float(2.0 * slope.mean() ** 2 / (score**2).mean())
