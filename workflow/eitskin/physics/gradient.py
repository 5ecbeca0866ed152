"""A conductivity that rises across the skin: sigma (1 + relative_across (r . n) / 2R).

With s = sigma / sigma_0, unfolded coordinates and w = sqrt(s) u, div(s grad u) = 0 turns into Delta
w + k^2 w = 0, k^2 = |grad s|^2 / 4 s^2, with dw/dn = b w on the rim, b = n . grad s / 2 s: both
small and smooth. The Neumann function keeps its singularity and gains a correction,

    N(x, y) -> (N(x, y) + psi(x)^T C psi(y)) / sqrt(s(x) s(y)),

C Galerkin's in harmonics and in bubbles, which vanish on the rim and correct the harmonics inside
for k^2. A current of u through a line is sqrt(s) (dw/dn - b w), which `touch` uses. The
multipoles of touches are harmonic, off by (k a)^2 / 4 within a touch of radius a: with 0.3 across,
2e-5 of its change for an eighth of the skin's radius, 9e-5 for a quarter.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.linalg import block_diag

from eitskin.errors import InputError
from eitskin.physics.conformal import DiscMap
from eitskin.physics.geometry import Geometry

HARMONICS = 96  # twice the degree of the conformal map
# harmonics whose energy inside the disc is corrected; higher ones stay at the rim
LOW_HARMONICS = 31
WAVES, RADIAL = 12, 3  # orders of the bubbles, along angle and radius
RADII, ANGLES = 24, 128  # of the quadrature in the disc


class GradientBulk:
    """The correction of the Neumann function of one skin; sheet conductance 1 at its centre.

    matrix (terms, terms): C, of the terms of `terms`. Raises InputError where the conductivity
    would fall to 0 on the skin.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap):
        self.geometry, self.disc = geometry, disc
        theta = 2.0 * np.pi * np.arange(4 * HARMONICS) / (4 * HARMONICS)
        zeta = np.exp(1j * theta)
        place = self.unmapped(zeta)
        if not (self._relative(place) > 0).all():
            actual = f"{geometry.gradient_across:g}"
            raise InputError("skin", "gradient_across", actual, "a conductivity above 0 everywhere")
        line = 1j * zeta / self.disc.derivatives(place, 1)[1] * 2.0 * np.pi / len(theta)
        self.matrix = self._correction(_harmonics(zeta, HARMONICS), self.bend(place, line))

    @cached_property
    def _slope(self) -> complex:
        """Gradient of s in unfolded coordinates, 1/mm: s = 1 + Re(conj(slope) y)."""
        g = self.geometry
        direction = np.exp(1j * np.radians(g.gradient_deg)) * g.gradient_across / (2 * g.radius_mm)
        inverse = g.with_values(anisotropy_ratio=1.0 / g.anisotropy_ratio)
        return complex(inverse.unfold(np.array([direction]))[0])

    def _relative(self, unfolded: np.ndarray) -> np.ndarray:
        """s at unfolded places, mm."""
        return 1.0 + (np.conj(self._slope) * unfolded).real

    def unmapped(self, zeta: np.ndarray) -> np.ndarray:
        """Unfolded places, mm, of points of the unit disc, by Newton's method on the conformal
        map."""
        place = zeta * self.disc.scale
        for _ in range(50):
            f, slope = self.disc.derivatives(place, 1)
            step = (f - zeta) / slope
            place = place - step
            if np.abs(step).max(initial=0.0) < 1e-12 * self.disc.scale:
                break
        return place

    def _correction(self, on_rim: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """(terms, terms): C, the inverse of the energy of the terms, minus that of a uniform
        skin."""
        order = np.arange(1, HARMONICS + 1)
        stiffness = np.concatenate([[1.0], np.pi * order, np.pi * order])
        quadrature = _disc_quadrature()
        size = len(stiffness) + len(quadrature.energy)
        change = np.zeros((size, size))
        change[: len(stiffness), : len(stiffness)] = -on_rim.T @ (bend[:, None] * on_rim)
        place = self.unmapped(quadrature.zeta)
        stretch = 1.0 / np.abs(self.disc.derivatives(place, 1)[1]) ** 2
        square = 0.25 * np.abs(self._slope) ** 2 / self._relative(place) ** 2
        weight = square * stretch * quadrature.area
        low_terms = np.r_[
            0 : LOW_HARMONICS + 1,
            HARMONICS + 1 : HARMONICS + 1 + LOW_HARMONICS,
            len(stiffness) : size,
        ]
        change[np.ix_(low_terms, low_terms)] -= quadrature.terms.T @ (
            weight[:, None] * quadrature.terms
        )
        even_energy = block_diag(np.diag(stiffness), quadrature.energy)
        even_inverse = block_diag(np.diag([0.0, *(1.0 / stiffness[1:])]), quadrature.inverse)
        return np.linalg.inv(even_energy + 0.5 * (change + change.T)) - even_inverse

    def terms(self, zeta: np.ndarray) -> np.ndarray:
        """psi (points, terms): 1, Re zeta^m, Im zeta^m, then the bubbles, in the unit disc."""
        return np.hstack([_harmonics(zeta, HARMONICS), _bubbles(zeta)])

    def flux(self, zeta: np.ndarray, dzeta: np.ndarray) -> np.ndarray:
        """(points, terms): flux of psi through the line elements `dzeta`."""
        powers = np.vander(zeta, HARMONICS, increasing=True)
        slope = np.arange(1, HARMONICS + 1) * powers * dzeta[:, None]
        bubble = (np.conj(_bubble_slopes(zeta)) * dzeta[:, None]).imag
        return np.hstack([np.zeros((len(zeta), 1)), slope.imag, -slope.real, bubble])

    def bend(self, place: np.ndarray, line: np.ndarray) -> np.ndarray:
        """(points,): b ds on line elements, mm, at unfolded places, mm."""
        return 0.5 * (np.conj(self._slope) * line).imag / self._relative(place)

    def factor(self, physical: np.ndarray) -> np.ndarray:
        """1 / sqrt(s) at physical places, mm, complex."""
        return self._relative(self.geometry.unfold(physical)) ** -0.5


@dataclass(frozen=True)
class _DiscQuadrature:
    """Nodes of the unit disc and their areas (points,), the low terms there, and the energy of
    the bubbles with its inverse; bubbles and harmonics are orthogonal."""

    zeta: np.ndarray
    area: np.ndarray
    terms: np.ndarray
    energy: np.ndarray
    inverse: np.ndarray


@cache
def _disc_quadrature() -> _DiscQuadrature:
    node, weight = np.polynomial.legendre.leggauss(RADII)
    radius, radius_weight = 0.5 * (1.0 + node), 0.5 * weight
    theta = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    zeta = (radius[:, None] * np.exp(1j * theta)).ravel()
    area = np.repeat(radius * radius_weight, ANGLES) * 2.0 * np.pi / ANGLES
    slope = _bubble_slopes(zeta)
    energy = ((np.conj(slope) * area[:, None]).T @ slope).real
    terms = np.hstack([_harmonics(zeta, LOW_HARMONICS), _bubbles(zeta)])
    return _DiscQuadrature(zeta, area, terms, energy, np.linalg.inv(energy))


def _harmonics(zeta: np.ndarray, degree: int) -> np.ndarray:
    """(points, 2 degree + 1): 1, Re zeta^m, Im zeta^m."""
    powers = np.vander(zeta, degree + 1, increasing=True)[:, 1:]
    return np.hstack([np.ones((len(zeta), 1)), powers.real, powers.imag])


def _radial(zeta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(points, 1, RADIAL): (1 - q) q^n, q = |zeta|^2, and its derivative by q."""
    square, n = np.abs(zeta[:, None, None]) ** 2, np.arange(RADIAL)
    power = np.vander(square.ravel(), RADIAL, increasing=True)[:, None, :]
    slope = n * np.roll(power, 1, axis=-1)
    return (1.0 - square) * power, (1.0 - square) * slope - power


def _bubbles(zeta: np.ndarray) -> np.ndarray:
    """(points, RADIAL (2 WAVES - 1)): Re and Im of zeta^m (1 - q) q^n, m < WAVES."""
    value = np.vander(zeta, WAVES, increasing=True)[:, :, None] * _radial(zeta)[0]
    value = value.reshape(len(zeta), WAVES * RADIAL)
    return np.hstack([value.real, value[:, RADIAL:].imag])


def _bubble_slopes(zeta: np.ndarray) -> np.ndarray:
    """(points, bubbles): their gradients, d/dx + i d/dy."""
    (value, slope), m = _radial(zeta), np.arange(WAVES)[:, None]
    place, power = zeta[:, None, None], np.vander(zeta, WAVES, increasing=True)[:, :, None]
    zeta_slope = m * np.roll(power, 1, axis=1) * value + power * np.conj(place) * slope
    conj_slope = power * place * slope
    zeta_slope, conj_slope = (
        part.reshape(len(zeta), WAVES * RADIAL) for part in (np.conj(zeta_slope), conj_slope)
    )
    return np.hstack([conj_slope + zeta_slope, 1j * (zeta_slope - conj_slope)[:, RADIAL:]])
