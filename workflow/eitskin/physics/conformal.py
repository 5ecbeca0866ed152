"""The conformal map of a star-shaped skin onto the unit disc.

Laplace's equation, the flux through a curve and so the whole sheet problem are invariant under it;
what a shape does to an EIT skin is therefore where it sends the electrodes and the touches. With
f(z) = z exp(F(z)), |f| = 1 on the rim asks for the analytic F with Re F = -ln|z| there: linear.
(Henrici, Applied and Computational Complex Analysis III, § 16.7.)
"""

import numpy as np
from numpy.polynomial import polynomial

DEGREE = 48
MOST_ORDER = 3  # of a derivative
ROUNDING = 3e-15  # what is under it in a coefficient is the rounding of its linear system


class DiscMap:
    """f: skin -> unit disc with f(0) = 0, f'(0) > 0, from points on the rim.

    `rim` (P,) complex: points on the rim, once round, evenly dense; P > 2 * DEGREE.
    Lengths are in any one unit. Raises ValueError where the rim is not star-shaped or too rough for
    a polynomial of DEGREE: `defect`, the largest | |f| - 1 | at the rim points, then exceeds 1e-7.
    """

    def __init__(self, rim: np.ndarray):
        self.scale = np.abs(rim).max()
        self._rim = rim
        self._matrix = np.linalg.pinv(_real_basis(rim / self.scale))
        whole = _to_complex(self._matrix @ -np.log(np.abs(rim)))
        kept = np.flatnonzero(np.abs(whole[1:]) > ROUNDING)
        coefficients = whole[: kept.max(initial=-1) + 2]
        self._derived = [polynomial.polyder(coefficients, k) for k in range(MOST_ORDER + 1)]
        self.defect = float(np.abs(np.abs(self(rim)) - 1.0).max())
        if self.defect > 1e-7:
            raise ValueError(f"rim too rough for a conformal map: | |f| - 1 | = {self.defect:.1e}")

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """f(z)."""
        return z * np.exp(self._polynomial(self._derived, z, 0))

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f, f', ... up to `order` <= 3] at z."""
        g = [self._polynomial(self._derived, z, k) for k in range(order + 1)]
        exp = np.exp(g[0])
        f = [z * exp]
        if order >= 1:
            f.append(exp * (1 + z * g[1]))
        if order >= 2:
            f.append(exp * (2 * g[1] + z * (g[1] ** 2 + g[2])))
        if order >= 3:
            f.append(exp * (3 * (g[1] ** 2 + g[2]) + z * (g[1] ** 3 + 3 * g[1] * g[2] + g[3])))
        return f

    def velocity(self, rim_velocity: np.ndarray) -> "MapVelocity":
        """How f changes when the rim points move with `rim_velocity` (P,) complex."""
        slope = self._polynomial(self._derived, self._rim, 1)
        change = -np.real(rim_velocity / self._rim) - np.real(slope * rim_velocity)
        return MapVelocity(self, _to_complex(self._matrix @ change))

    def _polynomial(self, derived: list[np.ndarray], z: np.ndarray, order: int) -> np.ndarray:
        return polynomial.polyval(z / self.scale, derived[order], tensor=False) / self.scale**order


class MapVelocity:
    """The derivative of a DiscMap, as a function of the place: f_dot = f F_dot."""

    def __init__(self, disc_map: DiscMap, coefficients: np.ndarray):
        self._map = disc_map
        self._derived = [polynomial.polyder(coefficients, k) for k in range(MOST_ORDER)]

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f_dot, f_dot', ... up to `order` <= 2] at z (Leibniz)."""
        f = self._map.derivatives(z, order)
        g = [self._map._polynomial(self._derived, z, k) for k in range(order + 1)]
        binomial = [[1], [1, 1], [1, 2, 1]]
        return [
            sum(binomial[n][k] * f[n - k] * g[k] for k in range(n + 1)) for n in range(order + 1)
        ]


def _real_basis(z: np.ndarray) -> np.ndarray:
    powers = z[:, None] ** np.arange(DEGREE + 1)
    return np.hstack([powers.real, -powers.imag[:, 1:]])


def _to_complex(real: np.ndarray) -> np.ndarray:
    coefficients = real[: DEGREE + 1].astype(complex)
    coefficients[1:] += 1j * real[DEGREE + 1 :]
    return coefficients
