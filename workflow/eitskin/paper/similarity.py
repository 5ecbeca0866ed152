"""How alike two sets of frames are: the four measures of Table II.

All are taken of channels z-scored by the recording, but for the correlation of the means: z-scored
by the recording, the recording's own means are 0 and correlate with nothing. The paper names the
measures and defines none; what it leaves open is decided here and said at each function.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.distance import cdist

MEASURES = {"mmd": "lower", "coral": "lower", "ncc": "higher", "swd": "lower"}  # nearer where
SHRINKAGE = 1e-3
PROJECTIONS = 64


def mmd_terms(squared: np.ndarray, first: int) -> tuple[float, float, float]:
    """Mean kernel within the `first` frames, within the others, and across, each 0 to 1.

    squared (N, N): squared distances of all pairs. The kernel exp(-d² / 2 s²) has the median
    distance of the pooled pairs for s (Gretton et al. 2012).
    """
    median = np.median(squared[np.triu_indices(len(squared), 1)])
    kernel = np.exp(-0.5 * squared / median) if median > 0 else (squared == 0).astype(float)
    within, other = kernel[:first, :first].mean(), kernel[first:, first:].mean()
    return float(within), float(other), float(kernel[:first, first:].mean())


def mmd(squared: np.ndarray, first: int) -> float:
    """Squared maximum mean discrepancy of the `first` and the other frames, biased, 0 to 2:
    within + within - 2 across, of `mmd_terms`.
    """
    within, other, across = mmd_terms(squared, first)
    return within + other - 2.0 * across


def coral(a: np.ndarray, b: np.ndarray) -> float:
    """Frobenius norm of the difference of the covariances of frames (n, M) and (m, M), neither
    squared nor divided by M (Sun et al. 2016 do both): so the paper's 164 of 208 z-scored channels
    can be one.

    Each covariance C is (1 - 0.001) C + 0.001 tr C / M.
    """
    return float(np.linalg.norm(_covariance(a) - _covariance(b)))


def _covariance(frames: np.ndarray) -> np.ndarray:
    covariance = np.atleast_2d(np.cov(frames, rowvar=False))
    middle = np.trace(covariance) / len(covariance)
    return (1.0 - SHRINKAGE) * covariance + SHRINKAGE * middle * np.eye(len(covariance))


def ncc(a: np.ndarray, b: np.ndarray) -> float:
    """Largest correlation of frames (M,) and (M,) over all circular shifts along the channels;
    NaN where one is the same on all channels.
    """
    a, b = a - a.mean(), b - b.mean()
    size = np.linalg.norm(a) * np.linalg.norm(b)
    alike = np.fft.irfft(np.fft.rfft(a) * np.conj(np.fft.rfft(b)), len(a))
    return float(alike.max() / size) if size > 0 else float("nan")


def directions(channels: int, seed: int) -> np.ndarray:
    """(M, 64): unit vectors, evenly over all directions."""
    drawn = np.random.default_rng(seed).standard_normal((channels, PROJECTIONS))
    return drawn / np.linalg.norm(drawn, axis=0)


def swd(a: np.ndarray, b: np.ndarray) -> float:
    """Sliced Wasserstein-1 distance of projected frames (n, P) and (m, P): the mean over the
    projections of `scipy.stats.wasserstein_distance`, all at once.
    """
    n, m = len(a), len(b)
    edges = np.unique(np.concatenate([np.arange(n + 1) / n, np.arange(m + 1) / m]))
    middle = 0.5 * (edges[1:] + edges[:-1])
    a, b = np.sort(a, axis=0), np.sort(b, axis=0)
    apart = a[(middle * n).astype(int)] - b[(middle * m).astype(int)]
    return float((np.diff(edges) @ np.abs(apart)).mean())


@dataclass(frozen=True)
class Pool:
    """Frames (N, M) of a recording and of simulations, in one unit, `real` (R,) the recording's
    rows; its channels must vary. `seed` draws the projections.
    """

    frames: np.ndarray
    real: np.ndarray
    seed: int

    @cached_property
    def standard(self) -> np.ndarray:
        """(N, M): z-scored by the recording."""
        own = self.frames[self.real]
        return (self.frames - own.mean(axis=0)) / own.std(axis=0)

    @cached_property
    def squared(self) -> np.ndarray:
        """(N, N): squared distances."""
        return cdist(self.standard, self.standard, "sqeuclidean")

    @cached_property
    def projected(self) -> np.ndarray:
        """(N, 64)."""
        return self.standard @ directions(self.frames.shape[1], self.seed)

    def mmd_terms(self, a: np.ndarray) -> tuple[float, float, float]:
        """As `mmd_terms`, of rows `a` (n,) and the recording."""
        both = np.concatenate([a, self.real])
        return mmd_terms(self.squared[np.ix_(both, both)], len(a))

    def compare(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """(4,), in the order of MEASURES: rows `a` (n,) against rows `b` (m,)."""
        both = np.concatenate([a, b])
        return np.array(
            [
                mmd(self.squared[np.ix_(both, both)], len(a)),
                coral(self.standard[a], self.standard[b]),
                ncc(self.frames[a].mean(axis=0), self.frames[b].mean(axis=0)),
                swd(self.projected[a], self.projected[b]),
            ]
        )

    def halves(self, rounds: int, rng: np.random.Generator) -> np.ndarray:
        """(rounds, 4): the recording's one random half against the other."""
        found = []
        for _ in range(rounds):
            order = rng.permutation(self.real)
            found.append(self.compare(*np.array_split(order, 2)))
        return np.array(found)

    def changes(
        self, a: np.ndarray, b: np.ndarray, rounds: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """(4,), (rounds, 4): how much farther from the recording the rows `a` (S, K) are than the
        rows `b` (S, K), and the same where each session may have changed sides by the toss of a
        coin: what is seen where a and b differ by nothing.

        Sessions are what is exchanged, for the frames of one share its draws.
        """
        observed = self.compare(a.ravel(), self.real) - self.compare(b.ravel(), self.real)
        permuted = []
        for _ in range(rounds):
            swap = rng.random(len(a))[:, None] < 0.5
            one, other = np.where(swap, b, a).ravel(), np.where(swap, a, b).ravel()
            permuted.append(self.compare(one, self.real) - self.compare(other, self.real))
        return observed, np.array(permuted)
