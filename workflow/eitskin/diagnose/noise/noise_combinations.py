"""Combinations of channels that hold noise alone, whatever the skin does."""

from dataclasses import dataclass

import numpy as np

from eitskin.diagnose.noise.estimate import MOST_LOST

LEAST_COMBINATIONS = 8  # fewer say nothing of the noise: a variance by so many is good to a half


@dataclass(frozen=True)
class NoiseCombinations:
    """Orthonormal combinations (M, P) of readings in units of `unit` (M,) that hold noise alone.

    They are the odd half of reciprocity; where that ties few channels, `odd` is empty and they are
    orthogonal to what simulated readings do over the channels. odd, even: halves of reciprocity.
    """

    basis: np.ndarray
    unit: np.ndarray
    odd: np.ndarray
    even: np.ndarray

    @classmethod
    def from_residual(
        cls,
        halves: tuple[np.ndarray, np.ndarray],
        residual: np.ndarray,
        sd: np.ndarray,
        channel_modes: np.ndarray,
    ) -> "NoiseCombinations":
        """Of odd and even half, residuals (N, M), NaN where lost, noise sd (M,) and channel modes
        (M, G) of the simulated readings in units of it."""
        odd, even = halves
        lost = np.isnan(residual).astype(float)
        lost_share = (lost @ (odd != 0.0) > 0.0).mean(axis=0)
        odd = odd[:, lost_share <= MOST_LOST]
        if odd.shape[1] >= LEAST_COMBINATIONS:
            return cls(odd, np.ones(len(sd)), odd, even)
        simulated = np.column_stack([1.0 / sd, channel_modes])
        basis = np.linalg.qr(simulated, mode="complete")[0][:, simulated.shape[1] :]
        return cls(basis, sd, np.empty((len(sd), 0)), np.eye(len(sd)))

    @property
    def reciprocal(self) -> bool:
        """Whether they are the odd half of reciprocity."""
        return self.odd.shape[1] > 0

    def variance(self, sd: np.ndarray) -> np.ndarray:
        """(P,) of the combinations, for channels' noise sd (M,)."""
        return (self.basis**2).T @ (sd / self.unit) ** 2

    def values(self, residual: np.ndarray) -> np.ndarray:
        """(N, P) of residuals (N, M), NaN where lost."""
        lost = np.isnan(residual)
        if self.reciprocal:
            values = np.where(lost, 0.0, residual) @ self.odd
            values[(lost.astype(float) @ (self.odd != 0.0)) > 0.0] = np.nan
            return values
        rows, filled = np.arange(len(residual)), residual / self.unit
        for k in np.flatnonzero(lost.any(axis=0)):
            recorded = ~lost[:, k]
            filled[:, k] = np.interp(rows, rows[recorded], filled[recorded, k])
        return filled @ self.basis
