"""A conductivity that rises across the skin: sigma (1 + relative_across (r . n) / 2R).

With s = sigma / sigma_0 and w = sqrt(s) u, div(s grad u) = 0 turns into Delta w = (Delta sqrt(s) /
sqrt(s)) w with a term on the rim, both small and smooth: the Neumann function keeps its
singularities and gains a correction in harmonics, N(x, y) -> (N(x, y) + psi(x)^T C psi(y)) /
sqrt(s(x) s(y)). A touch takes the conductivity at its centre for its own: 0.8 % of its change for
a radius of 20 mm, times across. C is Galerkin's, on harmonic functions; what the small volume term
would add beyond them is of second order in relative_across^2 / 16.
"""

import numpy as np

from eitskin.conformal import DiscMap
from eitskin.errors import InputError
from eitskin.geometry import Geometry

HARMONICS = 96
RADII, ANGLES = 24, 128


class GradientBulk:
    """The correction of the Neumann function of one skin; sheet conductance 1 at its centre.

    Raises InputError where the conductivity would fall to 0 on the skin.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap):
        self.geometry, self.disc = geometry, disc
        theta = 2.0 * np.pi * np.arange(4 * HARMONICS) / (4 * HARMONICS)
        place = self._inverse(np.exp(1j * theta))
        if not (self._relative(place) > 0).all():
            found = f"{geometry.gradient_across:g}"
            raise InputError("skin", "gradient_across", found, "a conductivity above 0 everywhere")
        self.matrix = self._correction(theta, place)

    def _slope(self) -> complex:
        """Gradient of s in unfolded coordinates, 1/mm: s = 1 + Re(conj(slope) y)."""
        g = self.geometry
        direction = np.exp(1j * np.radians(g.gradient_deg)) * g.gradient_across / (2 * g.radius_mm)
        inverse = g.with_values(anisotropy_ratio=1.0 / g.anisotropy_ratio)
        return complex(inverse.unfold(np.array([direction]))[0])

    def _relative(self, unfolded: np.ndarray) -> np.ndarray:
        """s at unfolded places, mm."""
        return 1.0 + (np.conj(self._slope()) * unfolded).real

    def _inverse(self, zeta: np.ndarray) -> np.ndarray:
        """The unfolded place, mm, of points of the unit disc: Newton on the conformal map."""
        place = zeta * self.disc.scale
        for _ in range(50):
            f, slope = self.disc.derivatives(place, 1)
            step = (f - zeta) / slope
            place = place - step
            if np.abs(step).max() < 1e-12 * self.disc.scale:
                break
        return place

    def _correction(self, theta: np.ndarray, place: np.ndarray) -> np.ndarray:
        slope = self._slope()
        zeta = np.exp(1j * theta)
        dy = 1j * zeta / self.disc.derivatives(place, 1)[1]
        outward = (np.conj(slope) * dy).imag
        weight = 2.0 * np.pi / len(theta)
        on_rim = self.harmonics(zeta)
        rim = -0.5 * outward / self._relative(place) * weight
        change = on_rim.T @ (rim[:, None] * on_rim)
        change += self._volume(slope)
        order = np.arange(1, HARMONICS + 1)
        stiffness = np.concatenate([[1.0], np.pi * order, np.pi * order])
        full = np.diag(stiffness) + change
        known = np.concatenate([[0.0], 1.0 / stiffness[1:]])
        return np.linalg.inv(0.5 * (full + full.T)) - np.diag(known)

    def _volume(self, slope: complex) -> np.ndarray:
        node, weight = np.polynomial.legendre.leggauss(RADII)
        radius, radius_weight = 0.5 * (1.0 + node), 0.5 * weight
        theta = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
        zeta = (radius[:, None] * np.exp(1j * theta)).ravel()
        area = np.repeat(radius * radius_weight, ANGLES) * 2.0 * np.pi / ANGLES
        place = self._inverse(zeta)
        stretch = 1.0 / np.abs(self.disc.derivatives(place, 1)[1]) ** 2
        bend = -0.25 * np.abs(slope) ** 2 / self._relative(place) ** 2
        low = self.harmonics(zeta)
        keep = np.r_[0 : ANGLES // 4, HARMONICS + 1 : HARMONICS + ANGLES // 4]
        change = np.zeros((2 * HARMONICS + 1, 2 * HARMONICS + 1))
        part = low[:, keep]
        change[np.ix_(keep, keep)] = part.T @ ((bend * stretch * area)[:, None] * part)
        return change

    def harmonics(self, zeta: np.ndarray) -> np.ndarray:
        """psi (points, 2 HARMONICS + 1): 1, Re zeta^m, Im zeta^m."""
        powers = zeta[:, None] ** np.arange(1, HARMONICS + 1)
        return np.hstack([np.ones((len(zeta), 1)), powers.real, powers.imag])

    def factor(self, physical: np.ndarray) -> np.ndarray:
        """1 / sqrt(s) at physical places, mm, complex."""
        return self._relative(self.geometry.unfold(physical)) ** -0.5
