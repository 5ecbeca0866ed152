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

LENGTH = 8.0  # distances are measured in radii times this: no charge is at the log's zero


@dataclass(frozen=True)
class Plane:
    """Constant conductivity 1."""

    def root(self, x: np.ndarray) -> np.ndarray:
        """sqrt(s) at places x."""
        return np.ones(x.shape)

    def bend(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """b = n . grad s / 2 s: the flux sqrt(s) (dw/dn - b w) of u = w / sqrt(s)."""
        return np.zeros(x.shape)

    def rest(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(len(x), len(y)): the kernel without its -log|x - y| / 2 pi."""
        return np.full((len(x), len(y)), np.log(LENGTH) / (2.0 * np.pi))

    def normal_rest(self, x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Its derivative along `normal` at x."""
        return np.zeros((len(x), len(y)))


@dataclass(frozen=True)
class Tilted:
    """Conductivity 1 + Re(conj(slope) y)."""

    slope: complex

    def relative(self, x: np.ndarray) -> np.ndarray:
        """s at places x."""
        return 1.0 + (np.conj(self.slope) * x).real

    def root(self, x: np.ndarray) -> np.ndarray:
        """As Plane.root."""
        return np.sqrt(self.relative(x))

    def bend(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """As Plane.bend."""
        return (np.conj(self.slope) * normal).real / (2.0 * self.relative(x))

    def _chi(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        both = np.outer(self.relative(x), self.relative(y))
        return np.abs(x[:, None] - y) ** 2 * abs(self.slope) ** 2 / (4.0 * both)

    def rest(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """As Plane.rest."""
        apart = np.abs(x[:, None] - y)
        both = np.outer(self.relative(x), self.relative(y))
        at_once = np.log(8.0 * np.sqrt(both) / abs(self.slope)) / (2.0 * np.pi)
        chi = self._chi(x, y)
        m = 1.0 / (1.0 + chi)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = (ellipkm1(chi * m) * np.sqrt(m) + np.log(apart)) / (2.0 * np.pi)
        return np.where(chi > 0, value, at_once)

    def normal_rest(self, x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
        """As Plane.normal_rest."""
        m = 1.0 / (1.0 + self._chi(x, y))
        factor = np.sqrt(m) * ellipe(m)
        with np.errstate(divide="ignore", invalid="ignore"):
            plain = np.where(x[:, None] == y, 0.0, (normal[:, None] / (x[:, None] - y)).real)
        own = self.bend(x, normal)[:, None]
        return ((1.0 - factor) * plain + factor * own) / (2.0 * np.pi)


Medium = Plane | Tilted


def log_kernel(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """-log|x - y| / 2 pi of places apart."""
    return -np.log(np.abs(x[:, None] - y)) / (2.0 * np.pi)


def normal_kernel(x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Derivative of `log_kernel` along `normal` at x."""
    return -(normal[:, None] / (x[:, None] - y)).real / (2.0 * np.pi)


def potential(medium: Medium, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The medium's kernel of places apart."""
    return log_kernel(x, y) + medium.rest(x, y)


def flux(medium: Medium, x: np.ndarray, normal: np.ndarray, y: np.ndarray) -> np.ndarray:
    """dg/dn - b g at x, of places apart."""
    value = normal_kernel(x, normal, y)
    if isinstance(medium, Plane):
        return value
    value = value + medium.normal_rest(x, normal, y)
    return value - medium.bend(x, normal)[:, None] * potential(medium, x, y)
