"""Where the poles of a rational function lie that maps a skin onto the disc.

At a corner of angle alpha the map is singular like d^(pi / alpha), and poles that crowd outside the
corner with exponentially small distances resolve that (Gopal, Trefethen 2019, SIAM J. Numer. Anal.
57:2074). Between corners the map continues beyond the rim to where the skin, reflected there, meets
itself again: poles as far off as the largest disc within is large serve narrow places, at which
polynomials fail.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.physics.rim_curve import crowded

CURVED_SHARE = 0.4  # of that disc's radius, of poles beside a smooth rim
RE_ENTRANT = 1.6  # times as many poles at a corner that points inwards
CORNER_SHARE = 0.1  # of a corner's reach, within which its own poles serve alone
CLEAR_SHARE = 0.7  # of the way to the rim beyond, that a corner's poles go at most


@dataclass(frozen=True)
class Poles:
    """Poles outside a skin (P,) complex, and their distances from its rim (P,)."""

    place: np.ndarray
    distance: np.ndarray


NO_POLES = Poles(np.zeros(0, complex), np.zeros(0))


@dataclass(frozen=True)
class RimSample:
    """A rim as points in order, counter-clockwise, complex and in any one unit of length.

    place, normal (N,): points, and unit normals outwards; length (N,): of the rim that each stands
    for; corners (C,): indices of points that are corners.
    """

    place: np.ndarray
    normal: np.ndarray
    length: np.ndarray
    corners: np.ndarray


@dataclass(frozen=True)
class Fineness:
    """Poles at each corner; spacing of those beside the rim, over their distance from it."""

    corner: int
    spacing: float

    @property
    def most_at_corner(self) -> int:
        """Poles at a corner that points inwards."""
        return round(RE_ENTRANT * self.corner)


def placed(sample: RimSample, fineness: Fineness) -> Poles:
    """Poles at the corners of a rim and beside it."""
    corner_poles = [_at_corner(sample, k, fineness) for k in range(len(sample.corners))]
    places, distances = zip(*corner_poles, _beside(sample, fineness.spacing), strict=True)
    return Poles(np.concatenate(places), np.concatenate(distances))


def _at_corner(sample: RimSample, corner: int, fineness: Fineness) -> tuple[np.ndarray, np.ndarray]:
    size, index = len(sample.place), int(sample.corners[corner])
    place = sample.place[index]
    # The normal of each side, at the points before and behind the corner.
    before, after = sample.normal[index - 1], sample.normal[(index + 1) % size]
    outward = (before + after) / abs(before + after)
    is_convex = (np.conj(before) * after).imag > 0
    count = fineness.corner if is_convex else fineness.most_at_corner
    reach = min(_side_lengths(sample)[corner], CLEAR_SHARE * _clear(sample.place, place, outward))
    distance = reach * crowded(count)
    return place + outward * distance, distance


def _side_lengths(sample: RimSample) -> np.ndarray:
    """(C,): of each corner, the distance to the nearer of the corners beside it."""
    corners = sample.place[sample.corners]
    side = np.abs(np.roll(corners, -1) - corners)
    return np.minimum(side, np.roll(side, 1))


def _clear(rim: np.ndarray, place: complex, direction: complex) -> float:
    """Length of a ray from a corner until it meets the rim; infinite where it never does."""
    start = (rim - place) / direction
    stop = np.roll(start, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = start.imag / (start.imag - stop.imag)
        along = start.real + share * (stop.real - start.real)
    near = 1e-6 * np.abs(start).max()
    meets = (share >= 0) & (share <= 1) & (along > near)
    return float(along[meets].min(initial=np.inf))


def _beside(sample: RimSample, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    away = np.ones(len(sample.place), bool)
    for index, reach in zip(sample.corners, _side_lengths(sample), strict=True):
        away &= np.abs(sample.place - sample.place[index]) > CORNER_SHARE * reach
    place, normal, length = (
        values[away] for values in (sample.place, sample.normal, sample.length)
    )
    rim = np.concatenate([place, sample.place[sample.corners]])
    distance = np.minimum(_touching(place, normal, rim, -1.0), _touching(place, normal, rim, 1.0))
    if not len(sample.corners):
        distance = CURVED_SHARE * distance
    count = length / (spacing * distance)
    total = np.cumsum(count)
    steps = np.arange(int(total[-1])) + 0.5
    index = np.searchsorted(total, steps)
    return place[index] + normal[index] * distance[index], distance[index]


def _touching(place: np.ndarray, normal: np.ndarray, rim: np.ndarray, side: float) -> np.ndarray:
    """(N,): radius of the largest disc that touches the rim at each place, within (side -1) or
    outside (side 1), and holds no point of `rim`; infinite where nothing bounds it."""
    radius = np.full(len(place), np.inf)
    for start in range(0, len(radius), 256):
        block = slice(start, start + 256)
        offset = rim - place[block, None]
        towards = side * (np.conj(normal[block, None]) * offset).real
        ahead = towards > 1e-6 * np.abs(offset)
        ball = 0.5 * np.abs(offset) ** 2 / np.where(ahead, towards, np.inf)
        radius[block] = np.where(ahead, ball, np.inf).min(axis=1)
    return radius
