"""Missing channels of a touch, estimated from the measured ones.

Changes, in units of the channels' spread, are modelled as zero-mean Gaussians with one precision P
for each class of strength (weak touches are mostly noise). For missing channels m given measured
channels o the conditional mean is -P_mm⁻¹ P_mo z_o, the conditional covariance P_mm⁻¹ (Bishop 2006,
Pattern Recognition and Machine Learning, equations 2.73 and 2.75).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

RIDGE = 1e-3  # of the mean variance: keeps moments of few frames invertible
STRENGTHS = 5  # classes: every one holds enough touches of a set for a precision of its own
DIRECTIONS = 6  # of the largest variance, along which the state's uncertainty is propagated
CACHE_SIZE = 4096  # sets of missing channels, at up to 40 kB each for 208 channels


def nan_mean(x: np.ndarray, axis: int | tuple[int, ...], keep: bool = False) -> np.ndarray:
    """Mean over the values that are not NaN: `np.nanmean`, to the bit, at a third of its cost for a
    single frame and without its warning where all are NaN."""
    present = ~np.isnan(x)
    count = present.sum(axis=axis, keepdims=keep)
    with np.errstate(invalid="ignore"):
        mean = np.where(present, x, 0.0).sum(axis=axis, keepdims=keep) / count
    return mean.astype(x.dtype)


def strength(z: np.ndarray) -> np.ndarray:
    """(N,): root mean square over the measured channels of changes (N, M) in units of spread."""
    return np.sqrt(nan_mean(np.square(z), -1))


def strength_edges(z: np.ndarray) -> np.ndarray:
    """(STRENGTHS - 1,): the quantiles of strength that divide changes (N, M) into equal classes."""
    return np.quantile(strength(z), np.linspace(0.0, 1.0, STRENGTHS + 1)[1:-1])


def precisions(z: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(K, M, M): the precision P of each class of strength, from changes (N, M) in units of spread:
    (E[z zᵀ] + RIDGE · mean variance)⁻¹."""
    class_precisions = []
    class_numbers = np.searchsorted(edges, strength(z))
    for class_number in range(len(edges) + 1):
        class_changes = z[class_numbers == class_number]
        moment = class_changes.T @ class_changes / len(class_changes)
        ridge = RIDGE * np.trace(moment) / len(moment)
        class_precisions.append(np.linalg.inv(moment + ridge * np.eye(len(moment))))
    return np.array(class_precisions)


@dataclass(frozen=True)
class Missing:
    """Missing channels (m,) of a class of strength, the measured ones (o,), and the gain (m, o)
    that gives the conditional mean of the missing from the measured."""

    class_number: int
    channels: tuple[int, ...]
    measured: np.ndarray
    gain: np.ndarray


class Channels:
    """The Gaussian of a predictor's channels: `precision` (K, M, M) of each class of strength,
    `edges` (K - 1,) of the classes."""

    def __init__(self, precision: np.ndarray, edges: np.ndarray):
        self.precision, self.edges = precision, edges
        self.missing = lru_cache(CACHE_SIZE)(self._missing)
        self.root = lru_cache(CACHE_SIZE)(self._root)

    def strength_class(self, z: np.ndarray) -> int:
        """The class of strength of one change (M,), NaN where a channel is missing."""
        return int(np.searchsorted(self.edges, strength(z)))

    def _missing(self, class_number: int, missing_channels: tuple[int, ...]) -> Missing:
        """The conditional mean's gain for missing channels in a class of strength."""
        precision = self.precision[class_number]
        missing_rows = np.array(missing_channels, dtype=int)
        measured = np.delete(np.arange(len(precision)), missing_rows)
        gain = -np.linalg.solve(
            precision[np.ix_(missing_rows, missing_rows)], precision[np.ix_(missing_rows, measured)]
        )
        return Missing(class_number, missing_channels, measured, gain)

    def _root(
        self, class_number: int, missing_channels: tuple[int, ...], target_channels: tuple[int, ...]
    ) -> np.ndarray:
        """(m, r): the principal directions of the conditional covariance of `target_channels`, a
        subset of the missing ones, each one standard deviation long, regressed onto all the missing
        channels."""
        covariance = np.linalg.inv(
            self.precision[class_number][np.ix_(missing_channels, missing_channels)]
        )
        target_rows = np.searchsorted(missing_channels, target_channels)
        variances, axes = np.linalg.eigh(covariance[np.ix_(target_rows, target_rows)])
        largest = slice(-min(DIRECTIONS, len(target_channels)), None)
        return covariance[:, target_rows] @ (axes[:, largest] / np.sqrt(variances[largest]))

    def pattern_weights(
        self, pattern: np.ndarray, class_number: int, missing_channels: tuple[int, ...]
    ) -> np.ndarray:
        """(M,): weights w whose product w·z estimates the amplitude of `pattern` (M,) in a change z
        beside a touch of this class, both in units of spread: w = P p / (pᵀ P p), with 0 for the
        missing channels."""
        missing = self.missing(class_number, missing_channels)
        filled_pattern = pattern.copy()
        filled_pattern[list(missing_channels)] = missing.gain @ pattern[missing.measured]
        weights = self.precision[class_number] @ filled_pattern
        weights[list(missing_channels)] = 0.0
        return np.asarray(weights / (weights @ filled_pattern))

    def filled(self, z: np.ndarray, class_number: int) -> tuple[np.ndarray, Missing]:
        """A change (M,) with its missing channels, NaN, at their conditional mean, and those
        channels."""
        missing = self.missing(class_number, tuple(np.flatnonzero(np.isnan(z)).tolist()))
        filled = z.copy()
        filled[list(missing.channels)] = missing.gain @ z[missing.measured]
        return filled, missing

    def filled_together(self, z: np.ndarray, missing_channels: np.ndarray) -> np.ndarray:
        """Changes (N, M) in units of spread with the same channels (m,) missing from all of them,
        these at their conditional mean."""
        filled, incomplete = z.copy(), z.copy()
        incomplete[:, missing_channels] = np.nan
        class_numbers = np.searchsorted(self.edges, strength(incomplete))
        for class_number in np.unique(class_numbers).tolist():
            rows = np.flatnonzero(class_numbers == class_number)
            missing = self.missing(class_number, tuple(missing_channels.tolist()))
            filled[np.ix_(rows, missing_channels)] = (
                z[np.ix_(rows, missing.measured)] @ missing.gain.T
            )
        return filled
