"""The spectrum of a channel's noise: white noise, and processes that last, each for its time."""

from dataclasses import dataclass

import numpy as np

WAVES_SHARE, MOST_WAVES = 0.97, 24  # of a slow process' variance, that so many waves hold at most
# Frames that noise may last for a filter to follow it. Beyond, it would carry what is off in a
# press into the presses after it; waves are used where they leave so little of the variance.
FOLLOWED, NEGLIGIBLE = 10.0, 0.02


@dataclass(frozen=True)
class Spectrum:
    """Of noise with unit variance: first-order processes (AR(1), in time Ornstein-Uhlenbeck), whose
    sum approximates any spectrum that falls towards high frequencies, and white noise.

    correlations (J,): of each process, from one frame to the next; shares (J,): of the variance
    that each has. White noise has the rest.
    """

    correlations: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()

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

    def wander(self, span: float) -> "Spectrum":
        """The processes that waves over a span of frames hold, without the others and white noise:
        longer than FOLLOWED, and what the waves leave of them is NEGLIGIBLE."""
        return self._part(self._is_wander(span))

    def followed(self, span: float) -> "Spectrum":
        """White noise and the processes that are no `wander` over a span, of unit variance."""
        part = self._part(~self._is_wander(span))
        variance = self.white_share + sum(part.shares)
        return Spectrum(part.correlations, tuple(share / variance for share in part.shares))

    def _is_wander(self, span: float) -> np.ndarray:
        """(J,) bool. Beyond K waves a first-order process of duration T has 2 span / (pi^2 K T) of
        its variance, by the eigenvalues of its covariance."""
        duration = -1.0 / np.log(np.array(self.correlations))
        left = 2.0 * span / (np.pi**2 * MOST_WAVES * duration) * np.array(self.shares)
        return (duration > FOLLOWED) & (left < NEGLIGIBLE)

    def _part(self, members: np.ndarray) -> "Spectrum":
        """The processes of a mask (J,)."""
        return Spectrum(
            *(
                tuple(float(v) for v in np.array(values)[members])
                for values in (self.correlations, self.shares)
            )
        )

    def waves(self, number: np.ndarray) -> np.ndarray:
        """(K, N): Karhunen-Loeve waves over frames of some numbers (N,) of its processes together,
        as of unit variance, without white noise: those that hold WAVES_SHARE of it, MOST_WAVES at
        most."""
        processes = self.covariance(number) - self.white_share * np.eye(len(number))
        eigenvalues, eigenvectors = np.linalg.eigh(processes / sum(self.shares))
        eigenvalues, eigenvectors = eigenvalues[::-1], eigenvectors[:, ::-1]
        held = np.cumsum(eigenvalues) / eigenvalues.sum()
        count = min(int(np.searchsorted(held, WAVES_SHARE)) + 1, MOST_WAVES)
        return (eigenvectors[:, :count] * np.sqrt(eigenvalues[:count])).T


WHITE = Spectrum()
