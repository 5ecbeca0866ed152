"""The spectrum of a channel's noise: white noise, and processes that last, each for its time."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spectrum:
    """Of noise with unit variance: first-order processes (AR(1), in time Ornstein-Uhlenbeck), whose
    sum approximates any spectrum that falls towards high frequencies, and white noise.

    correlations (J,): of each process, from one frame to the next; shares (J,): of the variance
    that each has. White noise has the rest.
    """

    correlations: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()

    @classmethod
    def first_order(cls, correlation: float) -> "Spectrum":
        """One process without white noise; white noise for a correlation of 0."""
        return cls((correlation,), (1.0,)) if correlation else cls()

    def __bool__(self) -> bool:
        """Whether something lasts from one frame to the next."""
        return bool(self.shares)

    @property
    def white_share(self) -> float:
        """Of the variance, that white noise has."""
        return max(1.0 - sum(self.shares), 0.0)

    @property
    def lag_one(self) -> float:
        """Correlation of the noise from one frame to the next."""
        return float(np.dot(self.shares, self.correlations))

    def covariance(self, number: np.ndarray) -> np.ndarray:
        """(N, N) of frames of some numbers (N,)."""
        gap = np.abs(np.subtract.outer(number, number)).astype(float)
        total = self.white_share * np.eye(len(number))
        for correlation, share in zip(self.correlations, self.shares, strict=True):
            total += share * correlation**gap
        return total

    def thinned(self, gap: float) -> "Spectrum":
        """The same of frames of which one in `gap` is there, by their order."""
        return Spectrum(tuple(c**gap for c in self.correlations), self.shares)
