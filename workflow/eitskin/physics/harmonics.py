"""The harmonics inside a touch."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Harmonics:
    """Powers 1 to `degree` of the place in the unit disc, about `centre` over `radius`, of unit
    energy on that circle.

    Those of one touch, or of several: centre and radius (...,), and points (..., points).
    """

    degree: int
    centre: np.ndarray
    radius: np.ndarray

    @classmethod
    def around(cls, boundary: np.ndarray, degree: int) -> "Harmonics":
        """Those on the circle about the middle of a boundary (..., points)."""
        across, up = boundary.real, boundary.imag
        centre = 0.5 * (across.min(-1) + across.max(-1) + 1j * (up.min(-1) + up.max(-1)))
        return cls(degree, centre, np.abs(boundary - centre[..., None]).max(-1))

    @cached_property
    def order(self) -> np.ndarray:
        """(degree,): 1 and up."""
        return np.arange(1, self.degree + 1)

    def powers(self, zeta: np.ndarray, derivative: int = 0) -> np.ndarray:
        """(..., points, degree) complex, or their derivative by zeta, once or twice."""
        scaled = (zeta - self.centre[..., None]) / self.radius[..., None]
        step = np.ones((*scaled.shape, self.degree), complex)
        step[..., derivative:] = scaled[..., None]
        factor = 1.0 / np.sqrt(self.order * np.pi)
        for lower in range(derivative):
            factor = factor * (self.order - lower)
        scale = np.asarray(self.radius)[..., None, None] ** -derivative
        return factor * scale * np.multiply.accumulate(step, axis=-1)

    def values(self, zeta: np.ndarray) -> np.ndarray:
        """(..., points, 2 degree): real and imaginary parts of the powers."""
        powers = self.powers(zeta)
        return np.concatenate([powers.real, powers.imag], axis=-1)

    def flux(self, zeta: np.ndarray, dzeta: np.ndarray) -> np.ndarray:
        """(..., points, 2 degree): their flux through the line elements `dzeta`."""
        slope = self.powers(zeta, 1) * dzeta[..., None]
        return np.concatenate([slope.imag, -slope.real], axis=-1)


def symmetric(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part of (..., K, K)."""
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
