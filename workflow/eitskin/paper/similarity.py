"""The similarity of two sets of frames: the four measures of Table II.

All use channels z-scored by the recording, except for the correlation of the means, as z-scored
means of the recording are 0. The paper names the measures without defining them; each docstring
states the choice made here.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.distance import cdist

MEASURES = {"mmd": "lower", "coral": "lower", "ncc": "higher", "swd": "lower"}  # where nearer
SHRINKAGE = 1e-3  # of a covariance to its mean variance, which keeps it regular with few frames
PROJECTIONS = 64  # of the sliced distance: their mean to some 10 % of the spread over directions


def mmd_terms(squared: np.ndarray, size: int) -> tuple[float, float, float]:
    """Mean kernel within the first `size` frames, within the remaining ones, and across, each 0 to
    1.

    squared (N, N): squared distances of all pairs. The kernel is exp(-d² / 2 s²) with s the median
    distance of the pooled pairs (Gretton et al. 2012).
    """
    median = np.median(squared[np.triu_indices(len(squared), 1)])
    kernel = np.exp(-0.5 * squared / median) if median > 0 else (squared == 0).astype(float)
    within_first, within_second = kernel[:size, :size].mean(), kernel[size:, size:].mean()
    return float(within_first), float(within_second), float(kernel[:size, size:].mean())


def mmd(squared: np.ndarray, size: int) -> float:
    """Squared maximum mean discrepancy, biased, 0 to 2, of the first `size` and the remaining
    frames: within_first + within_second - 2 across, of `mmd_terms`.
    """
    within_first, within_second, across = mmd_terms(squared, size)
    return within_first + within_second - 2.0 * across


def coral(a: np.ndarray, b: np.ndarray) -> float:
    """Frobenius norm of the difference of the covariances of frames (n, M) and (m, M), neither
    squared nor divided by M (unlike in Sun et al. 2016), as the paper's 164 of 208 z-scored
    channels suggest.

    Each covariance C is shrunk to (1 - 0.001) C + 0.001 (tr C / M) I.
    """
    return float(np.linalg.norm(_covariance(a) - _covariance(b)))


def _covariance(frames: np.ndarray) -> np.ndarray:
    covariance = np.atleast_2d(np.cov(frames, rowvar=False))
    mean_variance = np.trace(covariance) / len(covariance)
    return (1.0 - SHRINKAGE) * covariance + SHRINKAGE * mean_variance * np.eye(len(covariance))


def ncc(a: np.ndarray, b: np.ndarray) -> float:
    """Largest correlation of frames (M,) and (M,) over all circular shifts along the channels;
    NaN where one is constant over the channels.
    """
    a, b = a - a.mean(), b - b.mean()
    size = np.linalg.norm(a) * np.linalg.norm(b)
    correlation = np.fft.irfft(np.fft.rfft(a) * np.conj(np.fft.rfft(b)), len(a))
    return float(correlation.max() / size) if size > 0 else float("nan")


def directions(channels: int, seed: int) -> np.ndarray:
    """(M, 64): random unit vectors, uniform over all directions."""
    normal = np.random.default_rng(seed).standard_normal((channels, PROJECTIONS))
    return normal / np.linalg.norm(normal, axis=0)


def swd(a: np.ndarray, b: np.ndarray) -> float:
    """Sliced Wasserstein-1 distance of projected frames (n, P) and (m, P): the mean over the
    projections of `scipy.stats.wasserstein_distance`.
    """
    n, m = len(a), len(b)
    edges = np.unique(np.concatenate([np.arange(n + 1) / n, np.arange(m + 1) / m]))
    levels = 0.5 * (edges[1:] + edges[:-1])
    a, b = np.sort(a, axis=0), np.sort(b, axis=0)
    differences = a[(levels * n).astype(int)] - b[(levels * m).astype(int)]
    return float((np.diff(edges) @ np.abs(differences)).mean())


@dataclass(frozen=True)
class Pool:
    """Frames (N, M) of a recording and of simulations in the same unit; `real` (R,): the rows of
    the recording, whose channels must vary; `seed`: of the projections.
    """

    frames: np.ndarray
    real: np.ndarray
    seed: int

    @cached_property
    def standard(self) -> np.ndarray:
        """(N, M): z-scored by the recording."""
        recorded = self.frames[self.real]
        return (self.frames - recorded.mean(axis=0)) / recorded.std(axis=0)

    @cached_property
    def squared(self) -> np.ndarray:
        """(N, N): squared distances."""
        return cdist(self.standard, self.standard, "sqeuclidean")

    @cached_property
    def projected(self) -> np.ndarray:
        """(N, 64): the frames along random directions."""
        return self.standard @ directions(self.frames.shape[1], self.seed)

    def mmd_terms(self, simulated_rows: np.ndarray) -> tuple[float, float, float]:
        """`mmd_terms` of `simulated_rows` (n,) and the recording."""
        rows = np.concatenate([simulated_rows, self.real])
        return mmd_terms(self.squared[np.ix_(rows, rows)], len(simulated_rows))

    def compare(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """(4,), in the order of MEASURES: rows `a` (n,) against rows `b` (m,)."""
        rows = np.concatenate([a, b])
        return np.array(
            [
                mmd(self.squared[np.ix_(rows, rows)], len(a)),
                coral(self.standard[a], self.standard[b]),
                ncc(self.frames[a].mean(axis=0), self.frames[b].mean(axis=0)),
                swd(self.projected[a], self.projected[b]),
            ]
        )

    def halves(self, rounds: int, rng: np.random.Generator) -> np.ndarray:
        """(rounds, 4): the measures between random halves of the recording."""
        distances = []
        for _ in range(rounds):
            order = rng.permutation(self.real)
            distances.append(self.compare(*np.array_split(order, 2)))
        return np.array(distances)

    def changes(
        self, a: np.ndarray, b: np.ndarray, rounds: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """(4,), (rounds, 4): the differences of the measures to the recording between the rows `a`
        (S, K) and `b` (S, K), and their permutation distribution, with each session exchanged
        between a and b with probability 1/2.

        Whole sessions are exchanged, as the frames of a session share its draws.
        """
        observed = self.compare(a.ravel(), self.real) - self.compare(b.ravel(), self.real)
        permuted = []
        for _ in range(rounds):
            swap = rng.random(len(a))[:, None] < 0.5
            exchanged_a, exchanged_b = np.where(swap, b, a).ravel(), np.where(swap, a, b).ravel()
            permuted.append(
                self.compare(exchanged_a, self.real) - self.compare(exchanged_b, self.real)
            )
        return observed, np.array(permuted)
