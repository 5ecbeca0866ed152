"""Closed curves of smooth pieces: the outlines of flat skins.

Complex places in mm by the share of the perimeter from the first corner, anticlockwise.
"""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.interpolate import CubicSpline

from witness.triangles import COINCIDENT, within

SAMPLES = 512  # of an outline, from which distances are measured
Piece = Callable[[np.ndarray, int], np.ndarray]


class Outline:
    """A closed curve without crossings, anticlockwise, made of smooth pieces.

    pieces: functions of t from 0 to 1 that return complex places in mm, or their derivative of an
    order, for (t, order); panels: the parts of every piece within which it is analytic and which
    resolve it. Attributes: perimeter_mm; ends (P,): the pieces' starts as shares of the perimeter;
    angles (P,): the angles inside the skin at the pieces' starts, in radians; area_mm2. Raises
    ValueError for a clockwise outline.
    """

    def __init__(self, pieces: Sequence[Piece], panels: int = 1):
        self.pieces, self.panels = list(pieces), panels
        t = np.linspace(0.0, 1.0, panels + 1)
        nodes, weights = leggauss(16)
        self._nodes, self._weights = 0.5 * (1.0 + nodes), 0.5 * weights
        self._tables = []
        area, start = 0.0, 0.0
        for piece in self.pieces:
            inner = t[:-1, None] + self._nodes / panels
            rise = piece(inner, 1)
            length = start + np.append(0.0, np.cumsum(np.abs(rise) @ self._weights)) / panels
            area += 0.5 * float(((np.conj(piece(inner, 0)) * rise).imag @ self._weights).sum())
            self._tables.append(length)
            start = float(length[-1])
        if area <= 0.0:
            raise ValueError("an outline goes anticlockwise")
        self.perimeter_mm, self.area_mm2 = start, area / panels
        self.ends = np.array([length[0] for length in self._tables]) / start
        out = np.array([piece(np.zeros(1), 1)[0] for piece in self.pieces])
        back = np.roll([piece(np.ones(1), 1)[0] for piece in self.pieces], 1)
        self.angles = np.pi - np.angle(out / back)

    @property
    def unit_mm(self) -> float:
        """The perimeter over 2 pi."""
        return self.perimeter_mm / (2.0 * np.pi)

    @property
    def corners(self) -> np.ndarray:
        """(C,): the indices of the pieces that start at a corner."""
        return np.flatnonzero(np.abs(self.angles - np.pi) > 1e-6)

    def _along(self, share: np.ndarray, order: int) -> np.ndarray:
        share = np.asarray(share, float) % 1.0
        result = np.empty(share.shape, complex)
        number = np.searchsorted(self.ends, share, "right") - 1
        for k, (piece, length) in enumerate(zip(self.pieces, self._tables, strict=True)):
            chosen = number == k
            if chosen.any():
                result[chosen] = piece(
                    self._parameter(piece, length, share[chosen] * self.perimeter_mm), order
                )
        return result

    def _parameter(self, piece: Piece, length: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """t at lengths from the outline's start."""
        panel = np.clip(np.searchsorted(length, wanted, "right") - 1, 0, self.panels - 1)
        share = (wanted - length[panel]) / (length[panel + 1] - length[panel])
        first, t = panel / self.panels, (panel + share) / self.panels
        for _ in range(5):
            step = (t - first)[:, None]
            reached = step * np.abs(piece(first[:, None] + step * self._nodes, 1))
            error = length[panel] + reached @ self._weights - wanted
            t = t - error / np.abs(piece(t, 1))
        return np.clip(t, 0.0, 1.0)

    def place(self, share: np.ndarray) -> np.ndarray:
        """Complex places in mm at shares of the perimeter, of any shape."""
        return self._along(share, 0)

    def normal(self, share: np.ndarray) -> np.ndarray:
        """Outward unit normals, complex, at shares of the perimeter."""
        rise = self._along(share, 1)
        return -1j * rise / np.abs(rise)

    @cached_property
    def samples(self) -> np.ndarray:
        """(S,) complex, mm: the corners of a polygon close to the outline."""
        share = np.sort(np.append(np.arange(SAMPLES) / SAMPLES, self.ends[self.corners]))
        return self.place(share[np.diff(share, append=1.0) > COINCIDENT])

    def depth(self, place: complex) -> float:
        """The distance in mm of a place from the outline, less than 0 outside."""
        distance = float(to_polygon(np.array([place]), self.samples)[0])
        return distance if within(np.array([place]), self.samples)[0] else -distance

    def bend(self, share: np.ndarray) -> np.ndarray:
        """The curvature in 1 / mm at shares of the perimeter."""
        rise, second = self._along(share, 1), self._along(share, 2)
        return (np.conj(rise) * second).imag / np.abs(rise) ** 3


def to_polygon(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,): the distance of places x (N,) from a closed polygon's sides."""
    side = np.roll(corners, -1) - corners
    from_start = x[:, None] - corners
    share = np.clip((np.conj(side) * from_start).real / np.abs(side) ** 2, 0.0, 1.0)
    return np.abs(from_start - share * side).min(axis=1)


def _side(start: complex, stop: complex) -> Piece:
    def along(t: np.ndarray, order: int) -> np.ndarray:
        return [start + (stop - start) * t, stop - start + 0.0 * t, 0j * t][order]

    return along


def _arc(start: float, stop: float, x_mm: float, y_mm: float) -> Piece:
    """The ellipse of half axes x_mm and y_mm between two parameters in radians."""

    def along(t: np.ndarray, order: int) -> np.ndarray:
        phi = start + (stop - start) * t + 0.5 * np.pi * order
        return (stop - start) ** order * (x_mm * np.cos(phi) + 1j * y_mm * np.sin(phi))

    return along


def polygon(corners_mm: np.ndarray) -> Outline:
    """The polygon with corners (C, 2) in mm, anticlockwise. Raises ValueError where clockwise."""
    places = np.asarray(corners_mm, float) @ [1.0, 1j]
    return Outline([_side(a, b) for a, b in zip(places, np.roll(places, -1), strict=True)])


def ellipse(x_mm: float, y_mm: float) -> Outline:
    """The ellipse of half axes x_mm and y_mm about 0, from (x_mm, 0)."""
    return Outline([_arc(0.0, 2.0 * np.pi, x_mm, y_mm)], 256)


def flat_disc(radius_mm: float, flat_mm: float) -> Outline:
    """A disc about 0 cut at y = -flat_mm, from the cut's right end."""
    start = -np.arcsin(flat_mm / radius_mm)
    turn = radius_mm * np.exp(1j * np.array([start, np.pi - start]))
    return Outline([_arc(start, np.pi - start, radius_mm, radius_mm), _side(turn[1], turn[0])], 64)


def spline(points_mm: np.ndarray) -> Outline:
    """The periodic cubic spline through points (N, 2) in mm, anticlockwise, by their distances'
    sum. Raises ValueError where clockwise."""
    places = np.asarray(points_mm, float) @ [1.0, 1j]
    places = np.append(places, places[0])
    knots = np.append(0.0, np.cumsum(np.abs(np.diff(places))))
    curve = CubicSpline(knots, places, bc_type="periodic")

    def part(k: int) -> Piece:
        step = knots[k + 1] - knots[k]
        return lambda t, order: step**order * curve(knots[k] + step * t, order)

    return Outline([part(k) for k in range(len(knots) - 1)], 4)
