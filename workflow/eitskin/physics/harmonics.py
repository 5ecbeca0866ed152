"""The harmonics inside a touch, and the field of their polarisation outside it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

MORE = 4  # moments than degrees


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


@dataclass(frozen=True)
class RimMoments:
    """The field on the rim of a charge on a curve inside it, by the curve's moments.

    int dN(x, y)/dn_y v(y) ds_y = (1 / pi) Im sum_j m_j (x - centre)^-j with m_j = int v(y) (y -
    centre)^(j - 1) dy: on the rim both logarithms of N agree. moments (..., 2 J, columns): real and
    imaginary parts, lengths over `radius`.
    """

    centre: np.ndarray
    radius: np.ndarray
    moments: np.ndarray

    @classmethod
    def of(
        cls, harmonics: Harmonics, zeta: np.ndarray, dzeta: np.ndarray, values: np.ndarray
    ) -> "RimMoments":
        """Of harmonics' values (..., points, columns) on even nodes of a closed curve: MORE moments
        than degrees, or as many as the nodes tell."""
        centre, radius = harmonics.centre, harmonics.radius
        count = min(harmonics.degree + MORE, zeta.shape[-1] - harmonics.degree - 2)
        line = dzeta / (np.pi * radius[..., None])
        powers = _powers((zeta - centre[..., None]) / radius[..., None], line, count)
        return cls(centre, radius, np.swapaxes(powers, -1, -2) @ values)

    def at(self, rim: np.ndarray) -> np.ndarray:
        """(..., points, columns): the field at rim points (points,)."""
        step = self.radius[..., None] / (rim - self.centre[..., None])
        powers = _powers(step, step, self.moments.shape[-2] // 2)
        real, imag = np.split(powers, 2, axis=-1)
        return np.concatenate([imag, real], axis=-1) @ self.moments


def _powers(step: np.ndarray, first: np.ndarray, count: int) -> np.ndarray:
    """(..., points, 2 count): first step^j for j = 0 and up, real parts, then imaginary ones."""
    powers = np.empty((*step.shape, 2 * count))
    for j in range(count):
        powers[..., j], powers[..., count + j] = first.real, first.imag
        first = first * step
    return powers


def symmetric(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part of (..., K, K)."""
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
