"""The conformal map of a simply connected skin onto the unit disc.

Laplace's equation, the flux through a curve and so the whole sheet problem are invariant under it;
what a shape does to an EIT skin is therefore where it sends the electrodes and the touches. With
f(z) = z exp(F(z)), |f| = 1 on the rim asks for the analytic F with Re F = -ln|z| there: linear.
(Henrici, Applied and Computational Complex Analysis III, § 16.7.) F is a polynomial for rims near a
disc, and a rational function with poles placed by `poles` for corners and narrow skins.
"""

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from scipy.linalg import solve_triangular

from eitskin.physics.arrays import NUMPY, as_in, library
from eitskin.physics.poles import NO_POLES, Poles

DEGREE = 48  # of the polynomial alone; a rim that is not fitted to 1e-7 is refused
POLED_DEGREE = 20  # of the polynomial beside poles
DAMPING = 1e-14  # of coefficients beside poles: keeps large ones from cancelling
NOWHERE = 1e6  # a pole of residue 0, in scales, that fills up the poles of several maps
MOST_ORDER = 3  # of a derivative
# Points evaluated at once, so that a block stays in a core's cache; the least for each of many
# maps.
BLOCK_POINTS, LEAST_BLOCK_POINTS = 1 << 11, 1 << 5
ROUNDING = 3e-15  # a smaller coefficient is the rounding of its linear system


class DiscMap:
    """f: skin -> unit disc with f(centre) = 0, f'(centre) > 0, from points on the rim.

    `rim` (N,) complex: points on the rim, once round, dense towards corners; without poles evenly
    dense, with a centre of 0, and N > 2 * DEGREE. phi (N,): their angles, kept for `velocity`.
    Lengths are in any one unit. Raises ValueError where the rim is no number, or too rough for the
    function: `defect`, the largest | |f| - 1 | at the rim points, then exceeds `most_defect`.
    """

    def __init__(
        self,
        rim: np.ndarray,
        phi: np.ndarray | None = None,
        poles: Poles = NO_POLES,
        centre: complex = 0.0,
        most_defect: float = 1e-7,
    ):
        if not np.isfinite(rim).all():
            raise ValueError("a rim that is no number")
        self.phi, self.centre = phi, centre
        self.scale = np.abs(rim - centre).max()
        self._rim = rim - centre
        self._poles = Poles(
            (poles.place - centre) / self.scale,
            poles.distance / self.scale,
            poles.inward,
            (poles.beyond - centre) / self.scale,
        )
        basis = _real_basis(self._rim / self.scale, self._poles)
        self._directions, self._triangle = np.linalg.qr(basis)
        full_series = self._fitted(-np.log(np.abs(self._rim)))
        if not len(poles.place):
            significant = np.flatnonzero(np.abs(full_series[1:]) > ROUNDING)
            full_series = full_series[: significant.max(initial=-1) + 2]
        self.series = self._series_of(full_series)
        self.defect = float(np.abs(np.abs(self(rim)) - 1.0).max())
        if not self.defect <= most_defect:
            raise ValueError(f"rim too rough for a conformal map: | |f| - 1 | = {self.defect:.1e}")

    def _series_of(self, coefficients: np.ndarray) -> "Series":
        terms = len(coefficients) - len(self._poles.place)
        residues = coefficients[terms:] * self._poles.distance
        return Series(coefficients[:terms], self.scale, poles=self._poles.place, residues=residues)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """f(z)."""
        return self.derivatives(z, 0)[0]

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f, f', ... up to `order` <= 3] at z."""
        return _mapped(self.series, z - self.centre, order)

    def velocity(self, rim_velocity: np.ndarray) -> "MapVelocity":
        """The derivative of f as the rim points move with `rim_velocity` (N,) complex, in mm per
        unit of a parameter."""
        slope = self.series(self._rim, 1)[1]
        drift = self._drift(rim_velocity)
        relative = rim_velocity if drift is None else rim_velocity - drift(self._rim, 0)[0]
        change = -np.real(rim_velocity / self._rim) - np.real(slope * relative)
        return MapVelocity(self, self._series_of(self._fitted(change)), drift)

    def _drift(self, rim_velocity: np.ndarray) -> "Series | None":
        """An analytic velocity that carries the corners that point inwards along, at which f' is
        infinite; None without any."""
        poles = self._poles
        if not len(poles.inward):
            return None
        corners = self._rim[poles.inward] / self.scale
        distance = np.abs(corners - poles.beyond)
        shares = distance / (corners[:, None] - poles.beyond)
        residues = np.linalg.solve(shares, rim_velocity[poles.inward]) * distance
        return Series(np.zeros(1, complex), self.scale, poles=poles.beyond, residues=residues)

    def _fitted(self, rim_values: np.ndarray) -> np.ndarray:
        """Complex coefficients, of powers and then of poles, whose function's real part on the rim
        fits values (N,) in least squares."""
        along = self._directions[: len(rim_values)].T @ rim_values
        real = solve_triangular(self._triangle, along, check_finite=False)
        terms = (len(real) + 1) // 2
        coefficients = real[:terms].astype(complex)
        coefficients[1:] += 1j * real[terms:]
        return coefficients


class MapVelocity:
    """The derivative of a DiscMap, as a function of the place: f_dot = f F_dot, with F_dot a
    series, less F' times the velocity `drift` of corners that point inwards."""

    def __init__(self, disc_map: DiscMap, series: "Series", drift: "Series | None"):
        self._map, self._series, self._drift = disc_map, series, drift

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f_dot, f_dot', ... up to `order` <= 2] at z (Leibniz)."""
        f = self._map.derivatives(z, order)
        g = self._series(z - self._map.centre, order)
        binomial = [[1], [1, 1], [1, 2, 1]]
        if self._drift is not None:
            slopes = self._map.series(z - self._map.centre, order + 1)[1:]
            drift = self._drift(z - self._map.centre, order)
            for n in range(order + 1):
                g[n] -= sum(binomial[n][k] * slopes[n - k] * drift[k] for k in range(n + 1))
        return [
            sum(binomial[n][k] * f[n - k] * g[k] for k in range(n + 1)) for n in range(order + 1)
        ]


class DiscMaps:
    """The maps of several skins, each at its own places: the interface of DiscMap for points (S,
    points).

    `array`: its library and device are those of the coefficients.
    """

    def __init__(self, maps: Sequence[DiscMap], array: Any):
        every_series = [disc_map.series for disc_map in maps]
        self.series = Series(
            _stacked([series.coefficients for series in every_series], 0.0),
            np.array([disc_map.scale for disc_map in maps])[:, None],
            array,
            _stacked([series.poles for series in every_series], NOWHERE),
            _stacked([series.residues for series in every_series], 0.0),
        )
        self._centre = as_in(np.array([disc_map.centre for disc_map in maps], complex), array)

    def select(self, indices: Any) -> "DiscMaps":
        """The maps at `indices` (P,), which may repeat."""
        selection = copy.copy(self)
        selection.series = self.series.select(indices)
        selection._centre = self._centre[indices]
        return selection

    def derivatives(self, z: np.ndarray, order: int) -> list[np.ndarray]:
        """[f, f', ... up to `order` <= 3] at z (S, points)."""
        return _mapped(self.series, z - self._centre.reshape(-1, *[1] * (z.ndim - 1)), order)


def _stacked(rows: Sequence[np.ndarray], filling: float) -> np.ndarray:
    """(S, longest) complex: rows, each filled up."""
    stack = np.full((len(rows), max(map(len, rows))), filling, complex)
    for row, values in zip(stack, rows, strict=True):
        row[: len(values)] = values
    return stack


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
    """A polynomial of x = z / scale with complex coefficients, plus residues over x - pole, and the
    derivatives of this by z.

    Horner's rule on blocks of about as many coefficients as there are blocks, and then on the
    blocks: a fifth of the calls, and each value depends on its own point alone, to the bit. Of
    several series, coefficients (S, terms), poles and residues (S, P) and scale (S, 1), as arrays
    like `array`.
    """

    def __init__(
        self,
        coefficients: np.ndarray,
        scale: Any,
        array: Any = NUMPY,
        poles: np.ndarray = NO_POLES.place,
        residues: np.ndarray = NO_POLES.place,
    ):
        self.coefficients = as_in(coefficients, array)
        *stack, terms = coefficients.shape
        size = math.ceil(math.sqrt(terms))
        count = math.ceil(terms / size)
        blocks = np.zeros((MOST_ORDER + 1, *stack, count * size), complex)
        for k, row in enumerate(blocks):
            derivative = polynomial.polyder(coefficients, k, axis=-1) / scale**k
            row[..., : derivative.shape[-1]] = derivative
        self._blocks = as_in(blocks.reshape(MOST_ORDER + 1, *stack, count, size), array)
        self.poles, self.residues = as_in(poles, array), as_in(residues, array)
        self.scale = as_in(scale, array) if stack else scale

    def select(self, indices: Any) -> "Series":
        """Of several series, those at `indices` (P,)."""
        selection = copy.copy(self)
        selection.coefficients = self.coefficients[indices]
        selection._blocks, selection.scale = self._blocks[:, indices], self.scale[indices]
        selection.poles, selection.residues = self.poles[indices], self.residues[indices]
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
        if self.poles.shape[-1]:
            step = max(BLOCK_POINTS // 8, 1) if xp is np else step
            for start in range(0, points, step):
                block = slice(start, start + step)
                values[..., block] += self._pole_values(x[..., block], order)
        return values.reshape(order + 1, *z.shape)

    def _pole_values(self, x: np.ndarray, order: int) -> np.ndarray:
        """(order + 1, ..., points): sums over the poles."""
        xp = library(x)
        inverse = 1.0 / (x[..., :, None] - self.poles[..., None, :])
        term = self.residues[..., None, :] * inverse
        sums = [xp.sum(term, axis=-1)]
        for k in range(1, order + 1):
            term = term * inverse
            sums.append((-1.0) ** k * math.factorial(k) / self.scale**k * xp.sum(term, axis=-1))
        return xp.stack(sums)

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


def _real_basis(x: np.ndarray, poles: Poles) -> np.ndarray:
    """Columns whose combination is the real part of a polynomial with residues at poles, and rows
    that keep residues from cancelling."""
    count = len(poles.place)
    powers = x[:, None] ** np.arange((POLED_DEGREE if count else DEGREE) + 1)
    columns = np.hstack([powers, poles.distance / (x[:, None] - poles.place)])
    basis = np.hstack([columns.real, -columns.imag[:, 1:]])
    if not count:
        return basis
    return np.vstack([basis, DAMPING * np.sqrt(len(x)) * np.eye(basis.shape[1])])
