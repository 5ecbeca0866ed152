"""Electrodes as pieces that lie on one side of the rim each: two where an electrode goes round a
corner.

Towards a corner of angle alpha the potential bends as the distance to the power pi / alpha, and so
does the angle on the disc. There the position across a piece grows as the cube of the parameter,
after which both are smooth for right angles, inwards and outwards, and nearly so for others.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre, polynomial

from eitskin.physics.geometry import CORNER_CLEARANCE, Geometry

GRADING = 2  # power of the distance from a corner, by the parameter, with which d phi / dt grows
LEAST_PIECE = 1e-9  # of an electrode's half width; a shorter piece is none


@dataclass(frozen=True)
class Pieces:
    """Stretches of the rim, one side each, of which n electrodes consist.

    electrode (m,): numbers of the electrodes that they belong to, ascending; middle, half (m,):
    rad; corner (m, 2): numbers of the corners at start and stop, -1 for none, gap (m, 2): radians
    between; free (m, 2): whether the end is the electrode's, and moves with it.
    """

    electrode: np.ndarray
    middle: np.ndarray
    half: np.ndarray
    corner: np.ndarray
    gap: np.ndarray
    free: np.ndarray

    def of(self, electrode: int) -> slice:
        """The pieces of one electrode."""
        start, stop = np.searchsorted(self.electrode, [electrode, electrode + 1])
        return slice(int(start), int(stop))

    @property
    def graded(self) -> np.ndarray:
        """(m, 2): whether nodes crowd at start and stop."""
        return self.corner >= 0


class _End(NamedTuple):
    """Of a piece: its place from the electrode's middle, rad; otherwise as of Pieces."""

    place: float
    corner: int
    gap: float
    free: bool


def pieces(geometry: Geometry) -> Pieces:
    """The pieces of a skin's electrodes; ends within CORNER_CLEARANCE of a corner count as at
    it."""
    middle = np.radians(geometry.electrode_deg)
    half = geometry.electrode_width_mm / (2.0 * geometry.radius_mm)
    n = len(middle)
    corners = geometry.outline.corner_phi if geometry.outline else np.zeros(0)
    offset = (corners - middle[:, None] + np.pi) % (2.0 * np.pi) - np.pi
    near = np.abs(offset) < half[:, None] + CORNER_CLEARANCE
    if not near.any():
        none = np.full((n, 2), -1)
        free = np.ones((n, 2), bool)
        return Pieces(np.arange(n), middle, half, none, np.zeros((n, 2)), free)
    rows = [
        (number, *ends)
        for number in range(n)
        for ends in pairwise(_ends(offset[number], half[number]))
    ]
    electrode = np.array([number for number, _, _ in rows])
    place, corner, gap, free = (
        np.array([(start[k], stop[k]) for _, start, stop in rows]) for k in range(4)
    )
    whole = free.all(axis=1)
    return Pieces(
        electrode,
        middle[electrode] + np.where(whole, 0.0, place.mean(axis=1)),
        np.where(whole, half[electrode], 0.5 * np.diff(place, axis=1)[:, 0]),
        corner,
        gap,
        free,
    )


def _ends(offset: np.ndarray, half: float) -> list[_End]:
    """The ends of an electrode's pieces, in order; offset (C,): of the corners from its middle."""
    start, stop = _End(-half, -1, 0.0, True), _End(half, -1, 0.0, True)
    between = []
    for corner in np.argsort(-np.abs(offset)).tolist():
        place = float(offset[corner])
        gap = abs(place) - half
        if gap < -LEAST_PIECE * half:
            between.append(_End(place, corner, 0.0, False))
        elif gap < CORNER_CLEARANCE and place < 0:
            start = _End(-half, corner, max(gap, 0.0), True)
        elif gap < CORNER_CLEARANCE:
            stop = _End(half, corner, max(gap, 0.0), True)
    return [start, *sorted(between), stop]


@dataclass(frozen=True)
class Grading:
    """The nodes across a piece, as t from -1 to 1 has them, crowded at its graded ends.

    position, slope (q,): place in half widths from the middle, and its derivative by t; from_end
    (2, q): half widths from start and stop; coefficients (order, K): of Legendre modes, for
    currents whose density by the rim's length is smooth by t, the first of them even and 1 in all,
    the others 0 in all.
    """

    position: np.ndarray
    slope: np.ndarray
    from_end: np.ndarray
    coefficients: np.ndarray


def grading(
    t: np.ndarray, weight: np.ndarray, order: int, at_start: bool, at_stop: bool
) -> Grading:
    """The grading for nodes t (q,) with their weights and so many Legendre modes."""
    if not (at_start or at_stop):
        return Grading(t, np.ones_like(t), np.stack([1.0 + t, 1.0 - t]), np.eye(order))
    law = _slope(at_start, at_stop)
    from_start, slope = _rise(1.0 + t, law)
    from_stop, _ = _rise(1.0 - t, _slope(at_stop, at_start))
    position = np.where(t < 0, from_start - 1.0, 1.0 - from_stop)
    count = order + 1 - len(law)
    root = np.sqrt(weight * slope)
    orthonormal = np.linalg.qr(legendre.legvander(t, count - 1) * root[:, None])[0]
    density = slope[:, None] * orthonormal / root[:, None]
    density[:, 0] = 0.5 * slope
    modes = legendre.legvander(t, order - 1)
    degree = 2.0 * np.arange(order)[:, None] + 1.0
    coefficients = degree * (modes.T @ (weight[:, None] * density))
    return Grading(position, slope, np.stack([from_start, from_stop]), coefficients)


def _slope(at_start: bool, at_stop: bool) -> np.ndarray:
    """Coefficients of d phi / dt by s = 1 + t, in half widths: it vanishes as the distance from a
    graded end to the power GRADING, and is 1 at an end that is not graded."""
    start, stop = polynomial.polypow([0.0, 1.0], GRADING), polynomial.polypow([2.0, -1.0], GRADING)
    if at_start and at_stop:
        slope = polynomial.polymul(start, stop)
        return np.asarray(slope * 2.0 / polynomial.polyval(2.0, polynomial.polyint(slope)))
    if at_start:
        return np.asarray(polynomial.polymul(start, [2.25, -1.0]))
    return np.asarray(polynomial.polymul(stop, [0.25, 1.0]))


def _rise(s: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integral from 0 to s of a polynomial with coefficients `slope`, and its value at s."""
    return polynomial.polyval(s, polynomial.polyint(slope)), polynomial.polyval(s, slope)


def combined(parts: list[np.ndarray], electrode: np.ndarray, half: np.ndarray) -> np.ndarray:
    """(m order, modes): Legendre modes of the pieces, for an electrode's modes: its whole current,
    spread by length, then what moves from its first piece to another, then those of each piece
    without a current in all.

    parts: coefficients (order, K) of every piece; electrode, half (m,) as of Pieces.
    """
    order = len(parts[0])
    columns = []
    for number in np.unique(electrode):
        indices = np.flatnonzero(electrode == number)
        share = half[indices] / half[indices].sum()
        even = np.zeros((len(indices), len(half), order))
        even[range(len(indices)), indices] = [parts[piece][:, 0] for piece in indices]
        columns += [np.tensordot(share, even, 1), *(even[1:] - even[0])]
        for piece in indices:
            for mode in parts[piece].T[1:]:
                column = np.zeros((len(half), order))
                column[piece] = mode
                columns.append(column)
    return np.stack([column.ravel() for column in columns], axis=1)
