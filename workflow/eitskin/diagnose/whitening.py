"""Residuals in units of their noise, numerical error and shared baselines in the covariance."""

from dataclasses import dataclass

import numpy as np

# Error of a simulation that is the same in every frame: what is left between two exact solvers of
# one model, of the median |v|.
COHERENT = 1e-5


@dataclass(frozen=True)
class Whitening:
    """Square root of the inverse covariance of readings (N, M), applied.

    Every channel's covariance over the frames is sd^2 (I + rho 1 1^T): independent noise and one
    constant error, the same in all frames, whose rho is infinite where the values are differences
    from one baseline. mask (N, M): readings that are there; sd (M,); rho (M,).
    """

    mask: np.ndarray
    sd: np.ndarray
    rho: np.ndarray

    @classmethod
    def of(cls, voltage: np.ndarray, sd: np.ndarray, difference: bool, error: np.ndarray):
        """For readings (N, M), NaN where lost, noise sd (M,) and a coherent error's sd (M,)."""
        rho = np.full(sd.shape, np.inf) if difference else (error / sd) ** 2
        return cls(np.isfinite(voltage), sd, rho)

    @property
    def size(self) -> int:
        """Number of readings, less those that a free constant takes."""
        return int(self.mask.sum() - np.isinf(self.rho).sum())

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M) whitened, 0 where lost."""
        scaled = np.where(self.mask, values, 0.0) / self.sd
        count = np.maximum(self.mask.sum(axis=0), 1)
        part = 1.0 - 1.0 / np.sqrt(1.0 + self.rho * count)
        mean = scaled.sum(axis=-2, keepdims=True) / count
        return scaled - self.mask * (part * mean)
