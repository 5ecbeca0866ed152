"""What the channels of a touch say of one another: a channel that is missing from those that are
left.

Changes are taken in units of the channels' spread, about 0, as Gaussians with one precision P for
each class of strength (weak touches are mostly noise). For channels m given the others o the
conditional mean is -P_mm⁻¹ P_mo z_o, its covariance P_mm⁻¹ (Bishop 2006, Pattern Recognition and
Machine Learning, equations 2.73 and 2.75).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

RIDGE = 1e-3  # of the mean variance, where few frames leave directions unseen
STRENGTHS = 5
DIRECTIONS = 6  # along which a state's uncertainty is asked for
KEPT = 4096  # sets of missing channels


def mean_there(x: np.ndarray, axis: int | tuple[int, ...], keep: bool = False) -> np.ndarray:
    """`np.nanmean`, to the bit, at a third of its cost for a single frame: NaN where nothing is
    there."""
    there = ~np.isnan(x)
    count = there.sum(axis=axis, keepdims=keep)
    with np.errstate(invalid="ignore"):
        mean = np.where(there, x, 0.0).sum(axis=axis, keepdims=keep) / count
    return mean.astype(x.dtype)


def strength(z: np.ndarray) -> np.ndarray:
    """(N,): root mean square of changes (N, M) in units of spread, over channels that are there."""
    return np.sqrt(mean_there(np.square(z), -1))


def edges_of(z: np.ndarray) -> np.ndarray:
    """What parts changes (N, M) into STRENGTHS classes, equally many in each."""
    return np.quantile(strength(z), np.linspace(0.0, 1.0, STRENGTHS + 1)[1:-1])


def precisions(z: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(K, M, M): P of each class of strength, of changes (N, M) in units of spread."""
    found = []
    own = np.searchsorted(edges, strength(z))
    for number in range(len(edges) + 1):
        chosen = z[own == number]
        moment = chosen.T @ chosen / len(chosen)
        ridge = RIDGE * np.trace(moment) / len(moment)
        found.append(np.linalg.inv(moment + ridge * np.eye(len(moment))))
    return np.array(found)


@dataclass(frozen=True)
class Missing:
    """gain (m, o): the missing channels' conditional mean of those that are left."""

    number: int
    gone: tuple[int, ...]
    left: np.ndarray
    gain: np.ndarray


class Channels:
    """The channels of an exported predictor; `precision` (K, M, M), `edges` (K - 1,)."""

    def __init__(self, precision: np.ndarray, edges: np.ndarray):
        self.precision, self.edges = precision, edges
        self.missing = lru_cache(KEPT)(self._missing)
        self.root = lru_cache(KEPT)(self._root)

    def class_of(self, z: np.ndarray) -> int:
        """The class of strength of one change (M,), NaN where a channel is missing."""
        return int(np.searchsorted(self.edges, strength(z)))

    def _missing(self, number: int, gone: tuple[int, ...]) -> Missing:
        """What the others say of the channels `gone`, in a class of strength."""
        own, lacking = self.precision[number], np.array(gone, dtype=int)
        left = np.delete(np.arange(len(own)), lacking)
        gain = -np.linalg.solve(own[np.ix_(lacking, lacking)], own[np.ix_(lacking, left)])
        return Missing(number, gone, left, gain)

    def _root(self, number: int, gone: tuple[int, ...], of: tuple[int, ...]) -> np.ndarray:
        """(m, r): the directions in which those channels `of` the `gone` are most uncertain given
        the others, a standard deviation long each, with what they make of the rest of the gone."""
        covariance = np.linalg.inv(self.precision[number][np.ix_(gone, gone)])
        own = np.searchsorted(gone, of)
        variances, axes = np.linalg.eigh(covariance[np.ix_(own, own)])
        most = slice(-min(DIRECTIONS, len(of)), None)
        return covariance[:, own] @ (axes[:, most] / np.sqrt(variances[most]))

    def along(self, pattern: np.ndarray, number: int, gone: tuple[int, ...]) -> np.ndarray:
        """(M,): what gives of a change, by their product, how much of `pattern` (M,) is in it
        beside a touch of the class of strength `number`, both in units of spread; 0 where `gone`.
        """
        missing = self.missing(number, gone)
        whole = pattern.copy()
        whole[list(gone)] = missing.gain @ pattern[missing.left]
        weights = self.precision[number] @ whole
        weights[list(gone)] = 0.0
        return np.asarray(weights / (weights @ whole))

    def filled(self, z: np.ndarray, number: int) -> tuple[np.ndarray, Missing]:
        """A change (M,) whose missing channels, NaN, are what the others say, and what is known."""
        missing = self.missing(number, tuple(np.flatnonzero(np.isnan(z)).tolist()))
        whole = z.copy()
        whole[list(missing.gone)] = missing.gain @ z[missing.left]
        return whole, missing

    def filled_alike(self, z: np.ndarray, gone: np.ndarray) -> np.ndarray:
        """Changes (N, M) in units of spread that all lack the channels `gone` (m,), filled."""
        whole, lacking = z.copy(), z.copy()
        lacking[:, gone] = np.nan
        own = np.searchsorted(self.edges, strength(lacking))
        for number in np.unique(own).tolist():
            rows = np.flatnonzero(own == number)
            missing = self.missing(number, tuple(gone.tolist()))
            whole[np.ix_(rows, gone)] = z[np.ix_(rows, missing.left)] @ missing.gain.T
        return whole
