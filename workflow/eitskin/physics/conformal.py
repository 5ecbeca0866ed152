"""The conformal map of a star-shaped skin onto the unit disc.

Laplace's equation, the flux through a curve and so the whole sheet problem are invariant under it;
what a shape does to an EIT skin is therefore where it sends the electrodes and the touches. With
f(z) = z exp(F(z)), |f| = 1 on the rim asks for the analytic F with Re F = -ln|z| there: linear.
(Henrici, Applied and Computational Complex Analysis III, § 16.7.)
"""

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from scipy.linalg import solve_triangular

from eitskin.physics.arrays import NUMPY, as_in, library

DEGREE = 48
MOST_ORDER = 3  # of a derivative
AT_ONCE, LEAST = 1 << 11, 1 << 5  # points, and of each of many maps
ROUNDING = 3e-15  # what is under it in a coefficient is the rounding of its linear system


class DiscMap:
    """f: skin -> unit disc with f(0) = 0, f'(0) > 0, from points on the rim.

    `rim` (P,) complex: points on the rim, once round, evenly dense; P > 2 * DEGREE.
    Lengths are in any one unit. Raises ValueError where the rim is no number, not star-shaped or
    too rough for a polynomial of DEGREE: `defect`, the largest | |f| - 1 | at the rim points, then
    exceeds 1e-7.
    """

    def __init__(self, rim: np.ndarray):
        if not np.isfinite(rim).all():
            raise ValueError("a rim that is no number")
        self.scale = np.abs(rim).max()
        self._rim = rim
        self._directions, self._triangle = np.linalg.qr(_real_basis(rim / self.scale))
        whole = self._fitted(-np.log(np.abs(rim)))
        kept = np.flatnonzero(np.abs(whole[1:]) > ROUNDING)
        coefficients = whole[: kept.max(initial=-1) + 2]
        self.series = Series(coefficients, self.scale)
        self.defect = float(np.abs(np.abs(self(rim)) - 1.0).max())
        if not self.defect <= 1e-7:
            raise ValueError(f"rim too rough for a conformal map: | |f| - 1 | = {self.defect:.1e}")

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """f(z)."""
        return z * np.exp(self.series(z, 0)[0])

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f, f', ... up to `order` <= 3] at z."""
        return _mapped(self.series, z, order)

    def velocity(self, rim_velocity: np.ndarray) -> "MapVelocity":
        """How f changes when the rim points move with `rim_velocity` (P,) complex."""
        slope = self.series(self._rim, 1)[1]
        change = -np.real(rim_velocity / self._rim) - np.real(slope * rim_velocity)
        return MapVelocity(self, self._fitted(change))

    def _fitted(self, rim_values: np.ndarray) -> np.ndarray:
        """Coefficients (DEGREE + 1,) complex whose real part on the rim is nearest to values
        (P,)."""
        along = self._directions.T @ rim_values
        return _to_complex(solve_triangular(self._triangle, along, check_finite=False))


class MapVelocity:
    """The derivative of a DiscMap, as a function of the place: f_dot = f F_dot."""

    def __init__(self, disc_map: DiscMap, coefficients: np.ndarray):
        self._map, self._series = disc_map, Series(coefficients, disc_map.scale)

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f_dot, f_dot', ... up to `order` <= 2] at z (Leibniz)."""
        f = self._map.derivatives(z, order)
        g = self._series(z, order)
        binomial = [[1], [1, 1], [1, 2, 1]]
        return [
            sum(binomial[n][k] * f[n - k] * g[k] for k in range(n + 1)) for n in range(order + 1)
        ]


class DiscMaps:
    """The maps of several skins, each at its own places: what DiscMap has of one, at (S, points).

    Of arrays like `array`: its library and device.
    """

    def __init__(self, maps: Sequence[DiscMap], array: Any):
        most = max(len(one.series.coefficients) for one in maps)
        coefficients = np.zeros((len(maps), most), complex)
        for row, one in zip(coefficients, maps, strict=True):
            row[: len(one.series.coefficients)] = one.series.coefficients
        self.series = Series(coefficients, np.array([one.scale for one in maps])[:, None], array)

    def only(self, which: Any) -> "DiscMaps":
        """The maps at indices (P,), which may repeat."""
        some = copy.copy(self)
        some.series = self.series.only(which)
        return some

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f, f', ... up to `order` <= 3] at z (S, points)."""
        return _mapped(self.series, z, order)


def _mapped(series: "Series", z: np.ndarray, order: int) -> list[np.ndarray]:
    g = series(z, order)
    exp = library(z).exp(g[0])
    f = [z * exp]
    if order >= 1:
        f.append(exp * (1 + z * g[1]))
    if order >= 2:
        f.append(exp * (2 * g[1] + z * (g[1] ** 2 + g[2])))
    if order >= 3:
        f.append(exp * (3 * (g[1] ** 2 + g[2]) + z * (g[1] ** 3 + 3 * g[1] * g[2] + g[3])))
    return f


class Series:
    """A polynomial of z / scale with complex coefficients, and its derivatives by z.

    Horner's rule on blocks of about as many coefficients as there are blocks, and then on these: a
    fifth of the calls, and each value is its point's alone to the bit. Of several, coefficients (S,
    terms) and scale (S, 1), as arrays like `array`.
    """

    def __init__(self, coefficients: np.ndarray, scale: Any, array: Any = NUMPY):
        self.coefficients = as_in(coefficients, array)
        *stack, terms = coefficients.shape
        size = math.ceil(math.sqrt(terms))
        count = math.ceil(terms / size)
        blocks = np.zeros((MOST_ORDER + 1, *stack, count * size), complex)
        for k, row in enumerate(blocks):
            own = polynomial.polyder(coefficients, k, axis=-1) / scale**k
            row[..., : own.shape[-1]] = own
        self._blocks = as_in(blocks.reshape(MOST_ORDER + 1, *stack, count, size), array)
        self.scale = as_in(scale, array) if stack else scale

    def only(self, which: Any) -> "Series":
        """Of several, those at indices (P,)."""
        some = copy.copy(self)
        some.coefficients = self.coefficients[which]
        some._blocks, some.scale = self._blocks[:, which], self.scale[which]
        return some

    def __call__(self, z: np.ndarray, order: int) -> np.ndarray:
        """(order + 1, *z.shape): value and derivatives up to `order` <= 3."""
        xp, (_, *stack, _, _) = library(z), self._blocks.shape
        x = z.reshape(*stack, -1) / self.scale
        found = xp.empty((order + 1, *x.shape), dtype=x.dtype, device=x.device)
        points = x.shape[-1]
        step = max(AT_ONCE // math.prod(stack), LEAST) if xp is np else max(points, 1)
        for start in range(0, points, step):
            some = slice(start, start + step)
            found[..., some] = self._at(x[..., some], self._blocks[: order + 1])
        return found.reshape(order + 1, *z.shape)

    def _at(self, x: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        *stack, count, size = blocks.shape
        shape = (*stack, count, x.shape[-1])
        inner = library(x).empty(shape, dtype=x.dtype, device=x.device)
        inner[...] = blocks[..., size - 1, None]
        power = x
        for k in reversed(range(size - 1)):
            inner *= x[..., None, :]
            inner += blocks[..., k, None]
            power = power * x
        found = inner[..., count - 1, :]
        for k in reversed(range(count - 1)):
            found = found * power + inner[..., k, :]
        return found


def _real_basis(z: np.ndarray) -> np.ndarray:
    powers = z[:, None] ** np.arange(DEGREE + 1)
    return np.hstack([powers.real, -powers.imag[:, 1:]])


def _to_complex(real: np.ndarray) -> np.ndarray:
    coefficients = real[: DEGREE + 1].astype(complex)
    coefficients[1:] += 1j * real[DEGREE + 1 :]
    return coefficients
