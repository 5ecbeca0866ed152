"""Free-space kernels of the sheet: the plane's logarithm, and that of a tilted conductivity.

For s = 1 + slope . y, div(s grad u) = 0 is Laplace's equation of rings about the axis s = 0, whose
kernel is a complete elliptic integral. With w = sqrt(s) u it becomes a symmetric kernel g(chi),
chi = d^2 |slope|^2 / (4 s s'), g = K(m) sqrt(m) / 2 pi, m = 1 / (1 + chi), with the plane's
singularity -log d / 2 pi (Jackson, Classical Electrodynamics, § 5.5; Abramowitz, Stegun 17.3).
Places are complex numbers in units of the skin's radius.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ellipe, ellipkm1

LENGTH = 8.0  # unit of distances in the logarithm, in radii, so that it never vanishes


@dataclass(frozen=True)
class Plane:
    """Constant conductivity 1."""

    def root(self, x: np.ndarray) -> np.ndarray:
        """sqrt(s) at places x."""
        return np.ones(x.shape)

    def bend(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """b = n . grad s / 2 s: the flux sqrt(s) (dw/dn - b w) of u = w / sqrt(s)."""
        return np.zeros(x.shape)

    def smooth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(len(x), len(y)): the smooth part of the kernel, without -log|x - y| / 2 pi."""
        return np.full((len(x), len(y)), np.log(LENGTH) / (2.0 * np.pi))

    def normal_smooth(self, x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The derivative of `smooth` along `normal` at x."""
        return np.zeros((len(x), len(y)))


@dataclass(frozen=True)
class Tilted:
    """Conductivity 1 + Re(conj(slope) y)."""

    slope: complex

    def relative(self, x: np.ndarray) -> np.ndarray:
        """s at places x."""
        return 1.0 + (np.conj(self.slope) * x).real

    def root(self, x: np.ndarray) -> np.ndarray:
        """sqrt(s) at places x."""
        return np.sqrt(self.relative(x))

    def bend(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """b = n . grad s / 2 s, as in `Plane.bend`."""
        return (np.conj(self.slope) * normal).real / (2.0 * self.relative(x))

    def _chi(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        product = np.outer(self.relative(x), self.relative(y))
        return np.abs(x[:, None] - y) ** 2 * abs(self.slope) ** 2 / (4.0 * product)

    def smooth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The smooth part of the kernel, as in `Plane.smooth`."""
        distance = np.abs(x[:, None] - y)
        product = np.outer(self.relative(x), self.relative(y))
        coincident_value = np.log(8.0 * np.sqrt(product) / abs(self.slope)) / (2.0 * np.pi)
        chi = self._chi(x, y)
        m = 1.0 / (1.0 + chi)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = (ellipkm1(chi * m) * np.sqrt(m) + np.log(distance)) / (2.0 * np.pi)
        return np.where(chi > 0, value, coincident_value)

    def normal_smooth(self, x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The derivative of `smooth` along `normal` at x."""
        m = 1.0 / (1.0 + self._chi(x, y))
        factor = np.sqrt(m) * ellipe(m)
        with np.errstate(divide="ignore", invalid="ignore"):
            plain = np.where(x[:, None] == y, 0.0, (normal[:, None] / (x[:, None] - y)).real)
        bend = self.bend(x, normal)[:, None]
        return ((1.0 - factor) * plain + factor * bend) / (2.0 * np.pi)


Medium = Plane | Tilted


def log_kernel(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """-log|x - y| / 2 pi of distinct places."""
    return -np.log(np.abs(x[:, None] - y)) / (2.0 * np.pi)


def normal_kernel(x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Derivative of `log_kernel` along `normal` at x."""
    return -(normal[:, None] / (x[:, None] - y)).real / (2.0 * np.pi)


def potential(medium: Medium, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The medium's kernel of distinct places."""
    return log_kernel(x, y) + medium.smooth(x, y)


def flux(medium: Medium, x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
    """dg/dn - b g at x, of distinct places."""
    value = normal_kernel(x, normal, y)
    if isinstance(medium, Plane):
        return value
    value = value + medium.normal_smooth(x, normal, y)
    return value - medium.bend(x, normal)[:, None] * potential(medium, x, y)
