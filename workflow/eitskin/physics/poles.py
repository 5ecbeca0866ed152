"""Where the poles of a rational function lie that maps a skin onto the disc.

At a corner of angle alpha the map is singular like d^(pi / alpha), and poles that crowd outside the
corner with exponentially small distances resolve that (Gopal, Trefethen 2019, SIAM J. Numer. Anal.
57:2074). Between corners the map continues beyond the rim to where the skin, reflected there, meets
itself again: poles as far off as the largest disc within is large serve narrow places, at which
polynomials fail.
"""

from dataclasses import dataclass, field

import numpy as np

from eitskin.physics.rim_curve import EVEN_POINTS, crowded

CURVED_SHARE = 0.4  # of that disc's radius, of poles beside a curve: the coarsest
RE_ENTRANT = 1.6  # times as many poles at a corner that points inwards
CORNER_SHARE = 0.1  # of a corner's reach, within which its own poles serve alone
# That share where the wedge outside a corner is narrower than a right angle, since the poles beside
# the rim follow its width; and the turn, in radians, beyond which it is.
NARROW_SHARE, NARROW_TURN = 1e-12, -1.65
BEYOND_SHARE = 0.5  # of a corner's reach: a pole that moves with it
NARROW_POLES = 0.3  # there of a point of the rim, at most: more would fit the points alone
CLEAR_SHARE = 0.7  # of the way to the rim beyond, that a corner's poles go at most


@dataclass(frozen=True)
class Poles:
    """Poles outside a skin (P,) complex, and their distances from its rim (P,); of corners that
    point inwards their indices (C,) among the rim's points, and a place beyond each (C,)."""

    place: np.ndarray
    distance: np.ndarray
    inward: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    beyond: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))


NO_POLES = Poles(np.zeros(0, complex), np.zeros(0))


@dataclass(frozen=True)
class RimSample:
    """A rim as points in order, counter-clockwise, complex and in any one unit of length.

    place, normal (N,): points, and unit normals outwards; length (N,): of the rim that each stands
    for; bent (N,): whether it is on a curve, and not a straight side; corners (C,): indices of
    points that are corners.
    """

    place: np.ndarray
    normal: np.ndarray
    length: np.ndarray
    bent: np.ndarray
    corners: np.ndarray


@dataclass(frozen=True)
class Fineness:
    """Poles at each corner; spacing of those beside the rim, over their distance from it; that
    distance beside a curve, over the touching disc's radius; points of the rim, evenly; times as
    many poles at a corner that points inwards."""

    corner: int
    spacing: float
    curved_share: float = CURVED_SHARE
    even_points: int = EVEN_POINTS
    re_entrant: float = RE_ENTRANT

    @property
    def most_at_corner(self) -> int:
        """Poles at a corner that points inwards."""
        return round(self.re_entrant * self.corner)


def placed(sample: RimSample, fineness: Fineness) -> Poles:
    """Poles at the corners of a rim and beside it."""
    corner_poles = [_at_corner(sample, k, fineness) for k in range(len(sample.corners))]
    places, distances = zip(*corner_poles, _beside(sample, fineness), strict=True)
    inward = [k for k in range(len(sample.corners)) if _turn(sample, k) < 0]
    corners = sample.place[sample.corners[inward]]
    farthest = np.array([places[k][-1] for k in inward], complex)
    return Poles(
        np.concatenate(places),
        np.concatenate(distances),
        sample.corners[inward],
        corners + BEYOND_SHARE * (farthest - corners),
    )


def _at_corner(sample: RimSample, corner: int, fineness: Fineness) -> tuple[np.ndarray, np.ndarray]:
    place = sample.place[int(sample.corners[corner])]
    before, after = _normals(sample, corner)
    outward = (before + after) / abs(before + after)
    count = fineness.corner if _turn(sample, corner) > 0 else fineness.most_at_corner
    reach = min(_side_lengths(sample)[corner], CLEAR_SHARE * _clear(sample.place, place, outward))
    distance = reach * crowded(count)
    # Nearer ones coincide with the corner, as far as its coordinates say where it is.
    distance = distance[distance > 4.0 * np.finfo(float).eps * np.abs(sample.place).max()]
    return place + outward * distance, distance


def _normals(sample: RimSample, corner: int) -> tuple[complex, complex]:
    """The normal of each side, at the points before and behind a corner."""
    index = int(sample.corners[corner])
    return sample.normal[index - 1], sample.normal[(index + 1) % len(sample.place)]


def _turn(sample: RimSample, corner: int) -> float:
    """By how much the rim turns at a corner, radians; less than 0 where it points inwards."""
    before, after = _normals(sample, corner)
    return float(np.angle(np.conj(before) * after))


def _side_lengths(sample: RimSample) -> np.ndarray:
    """(C,): of each corner, the smaller of two distances, one a side: to the corner at its other
    end, or on a curve to the farthest point of it."""
    corners = sample.place[sample.corners]
    behind = np.abs(np.roll(corners, -1) - corners)
    before = behind.copy()
    stops = np.roll(sample.corners, -1)
    for k, (start, stop) in enumerate(zip(sample.corners, stops, strict=True)):
        size = len(sample.place)
        side = (start + np.arange((stop - start - 1) % size + 2)) % size
        if sample.bent[side[:-1]].any():
            away = np.abs(sample.place[side] - corners[[k, (k + 1) % len(corners)], None])
            behind[k], before[k] = away.max(axis=1)
    return np.minimum(behind, np.roll(before, 1))


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


def _beside(sample: RimSample, fineness: Fineness) -> tuple[np.ndarray, np.ndarray]:
    away = np.ones(len(sample.place), bool)
    narrow = np.zeros(len(sample.place), bool)
    for corner, reach in enumerate(_side_lengths(sample)):
        share = NARROW_SHARE if _turn(sample, corner) < NARROW_TURN else CORNER_SHARE
        from_corner = np.abs(sample.place - sample.place[sample.corners[corner]])
        away &= from_corner > share * reach
        narrow |= from_corner < CORNER_SHARE * reach
    place, normal, length, bent = (
        values[away] for values in (sample.place, sample.normal, sample.length, sample.bent)
    )
    rim = np.concatenate([place, sample.place[sample.corners]])
    distance = np.minimum(_touching(place, normal, rim, -1.0), _touching(place, normal, rim, 1.0))
    distance = np.where(bent, fineness.curved_share, 1.0) * distance
    count = length / (fineness.spacing * distance)
    count = np.where(narrow[away], np.minimum(count, NARROW_POLES), count)
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
