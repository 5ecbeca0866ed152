"""The harmonics inside a touch, and the field of their polarisation outside it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.arrays import as_in, library

EXTRA_MOMENTS = 4  # beyond the degree, as an oval edge mixes orders
LARGEST_FOCUS = 0.2  # of foci over the centre's distance to the rim: above, moments converge slowly


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
        xp = library(boundary)

        def middle(along: np.ndarray) -> np.ndarray:
            return 0.5 * (xp.min(along, axis=-1) + xp.max(along, axis=-1))

        centre = middle(boundary.real) + 1j * middle(boundary.imag)
        return cls(degree, centre, xp.max(abs(boundary - centre[..., None]), axis=-1))

    @cached_property
    def order(self) -> np.ndarray:
        """(degree,): 1 and up."""
        return np.arange(1, self.degree + 1)

    def powers(self, zeta: np.ndarray, derivative: int = 0) -> np.ndarray:
        """(..., points, degree) complex, or their derivative by zeta, once or twice."""
        xp = library(zeta)
        scaled = (zeta - self.centre[..., None]) / self.radius[..., None]
        step = xp.ones((*scaled.shape, self.degree), dtype=scaled.dtype, device=zeta.device)
        step[..., derivative:] = scaled[..., None]
        factor = 1.0 / np.sqrt(self.order * np.pi)
        for lower in range(derivative):
            factor = factor * (self.order - lower)
        scale = self.radius[..., None, None] ** -derivative
        return as_in(factor, zeta) * scale * xp.cumulative_prod(step, axis=-1)

    def values(self, zeta: np.ndarray) -> np.ndarray:
        """(..., points, 2 degree): real and imaginary parts of the powers."""
        powers = self.powers(zeta)
        return library(powers).concat([powers.real, powers.imag], axis=-1)

    def flux(self, zeta: np.ndarray, dzeta: np.ndarray) -> np.ndarray:
        """(..., points, 2 degree): their flux through the line elements `dzeta`."""
        slope = self.powers(zeta, 1) * dzeta[..., None]
        return library(slope).concat([slope.imag, -slope.real], axis=-1)


class RimField:
    """The field on the rim of harmonics' values (..., nodes, columns) as a charge on even nodes of
    a closed curve, a touch's edge: int dN(x, y)/dn_y v(y) ds_y.

    It is (1 / pi) Im sum_j m_j (x - centre)^-j with the moments m_j = int v(y) (y - centre)^(j - 1)
    dy, as both logarithms of N agree on the rim. The degree plus EXTRA_MOMENTS moments are taken,
    or as many as the nodes resolve. They converge beyond the foci of an oval edge; where the foci
    are not well within the distance to the rim, the integral is evaluated directly.
    """

    def __init__(
        self, harmonics: Harmonics, zeta: np.ndarray, dzeta: np.ndarray, values: np.ndarray
    ):
        xp = library(zeta)
        self.centre, self.radius = harmonics.centre, harmonics.radius
        self.zeta, self.dzeta, self.values = zeta, dzeta, values
        step = (zeta - self.centre[..., None]).conj() / self.radius[..., None]
        foci = xp.sqrt(abs(1.0 - xp.min(abs(step), axis=-1) ** 2)) * self.radius
        self.oval = foci > LARGEST_FOCUS * (1.0 - abs(self.centre))
        count = min(harmonics.degree + EXTRA_MOMENTS, zeta.shape[-1] - harmonics.degree - 2)
        line = dzeta.conj() / (np.pi * self.radius[..., None])
        # (..., 2 J, columns): real and imaginary parts of conj(m_j) / pi, lengths over the radius.
        self.moments = _powers(line, step, count) @ values

    def potential(self, rim: np.ndarray) -> np.ndarray:
        """(..., points, columns): potential at rim points (points,) or (..., points)."""
        step = self.radius[..., None] / (rim - self.centre[..., None])
        potential = _powers(-1j * step, step, self.moments.shape[-2] // 2).mT @ self.moments
        rim = library(rim).broadcast_to(rim, step.shape)
        for index in map(tuple, np.argwhere(self.oval.tolist())):
            kernel = neumann.rim_flux_kernel(rim[index], self.zeta[index], self.dzeta[index])
            potential[index] = kernel @ self.values[index]
        return potential


def _powers(power: np.ndarray, step: np.ndarray, count: int) -> np.ndarray:
    """(..., 2 count, points): power * step^j for j = 0 ... count - 1, real parts, then imaginary
    parts."""
    xp, (*stack, points) = library(step), step.shape
    powers = xp.empty((*stack, 2 * count, points), dtype=step.real.dtype, device=step.device)
    for j in range(count):
        powers[..., j, :], powers[..., count + j, :] = power.real, power.imag
        power = power * step
    return powers


def symmetric(matrix: np.ndarray) -> np.ndarray:
    """The symmetric part of (..., K, K)."""
    return 0.5 * (matrix + matrix.mT)
