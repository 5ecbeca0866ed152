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

DEGREE = 48  # of the series; a rim that it does not fit to 1e-7 is refused
MOST_ORDER = 3  # of a derivative
# Points evaluated at once, so that a block stays in a core's cache; the least for each of many
# maps.
BLOCK_POINTS, LEAST_BLOCK_POINTS = 1 << 11, 1 << 5
ROUNDING = 3e-15  # a smaller coefficient is the rounding of its linear system


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
        full_series = self._fitted(-np.log(np.abs(rim)))
        significant = np.flatnonzero(np.abs(full_series[1:]) > ROUNDING)
        coefficients = full_series[: significant.max(initial=-1) + 2]
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
        """The derivative of f as the rim points move with `rim_velocity` (P,) complex."""
        slope = self.series(self._rim, 1)[1]
        change = -np.real(rim_velocity / self._rim) - np.real(slope * rim_velocity)
        return MapVelocity(self, self._fitted(change))

    def _fitted(self, rim_values: np.ndarray) -> np.ndarray:
        """Complex coefficients (DEGREE + 1,) whose real part on the rim fits values (P,) in
        least squares."""
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
    """The maps of several skins, each at its own places: the interface of DiscMap for points (S,
    points).

    `array`: its library and device are those of the coefficients.
    """

    def __init__(self, maps: Sequence[DiscMap], array: Any):
        terms = max(len(disc_map.series.coefficients) for disc_map in maps)
        coefficients = np.zeros((len(maps), terms), complex)
        for row, disc_map in zip(coefficients, maps, strict=True):
            row[: len(disc_map.series.coefficients)] = disc_map.series.coefficients
        self.series = Series(
            coefficients, np.array([disc_map.scale for disc_map in maps])[:, None], array
        )

    def select(self, indices: Any) -> "DiscMaps":
        """The maps at `indices` (P,), which may repeat."""
        selection = copy.copy(self)
        selection.series = self.series.select(indices)
        return selection

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

    Horner's rule on blocks of about as many coefficients as there are blocks, and then on the
    blocks: a fifth of the calls, and each value depends on its own point alone, to the bit. Of
    several series, coefficients (S, terms) and scale (S, 1), as arrays like `array`.
    """

    def __init__(self, coefficients: np.ndarray, scale: Any, array: Any = NUMPY):
        self.coefficients = as_in(coefficients, array)
        *stack, terms = coefficients.shape
        size = math.ceil(math.sqrt(terms))
        count = math.ceil(terms / size)
        blocks = np.zeros((MOST_ORDER + 1, *stack, count * size), complex)
        for k, row in enumerate(blocks):
            derivative = polynomial.polyder(coefficients, k, axis=-1) / scale**k
            row[..., : derivative.shape[-1]] = derivative
        self._blocks = as_in(blocks.reshape(MOST_ORDER + 1, *stack, count, size), array)
        self.scale = as_in(scale, array) if stack else scale

    def select(self, indices: Any) -> "Series":
        """Of several series, those at `indices` (P,)."""
        selection = copy.copy(self)
        selection.coefficients = self.coefficients[indices]
        selection._blocks, selection.scale = self._blocks[:, indices], self.scale[indices]
        return selection

    def __call__(self, z: np.ndarray, order: int) -> np.ndarray:
        """(order + 1, *z.shape): value and derivatives up to `order` <= 3."""
        xp, (_, *stack, _, _) = library(z), self._blocks.shape
        x = z.reshape(*stack, -1) / self.scale
        values = xp.empty((order + 1, *x.shape), dtype=x.dtype, device=x.device)
        points = x.shape[-1]
        step = (
            max(BLOCK_POINTS // math.prod(stack), LEAST_BLOCK_POINTS)
            if xp is np
            else max(points, 1)
        )
        for start in range(0, points, step):
            block = slice(start, start + step)
            values[..., block] = self._block_values(x[..., block], self._blocks[: order + 1])
        return values.reshape(order + 1, *z.shape)

    def _block_values(self, x: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        *stack, count, size = blocks.shape
        shape = (*stack, count, x.shape[-1])
        inner = library(x).empty(shape, dtype=x.dtype, device=x.device)
        inner[...] = blocks[..., size - 1, None]
        power = x
        for k in reversed(range(size - 1)):
            inner *= x[..., None, :]
            inner += blocks[..., k, None]
            power = power * x
        value = inner[..., count - 1, :]
        for k in reversed(range(count - 1)):
            value = value * power + inner[..., k, :]
        return value


def _real_basis(z: np.ndarray) -> np.ndarray:
    powers = z[:, None] ** np.arange(DEGREE + 1)
    return np.hstack([powers.real, -powers.imag[:, 1:]])


def _to_complex(real: np.ndarray) -> np.ndarray:
    coefficients = real[: DEGREE + 1].astype(complex)
    coefficients[1:] += 1j * real[DEGREE + 1 :]
    return coefficients
