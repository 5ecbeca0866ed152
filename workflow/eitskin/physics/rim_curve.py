"""Closed curves by their length: rims that are no circles.

Angles phi run from 0 to 2 pi with the length from the first corner, counter-clockwise, so that an
angle means the same on a disc and on any other rim: a share of its length.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eitskin.errors import InputError

# scipy.interpolate is imported where it is used: it costs 0.7 s at each start of the workflow.
if TYPE_CHECKING:
    from scipy.interpolate import BSpline

MOST_CORNERS = 64  # of a rim with corners; one that was drawn by more points is smooth
LEAST_AREA = 1e-6  # of a rim, over its length squared
LEAST_TURN_DEG = 0.1  # of a polygon's corner; two sides with a smaller turn are straight on
# Of a corner in a drawn rim, over the largest turn of the nearest two points without one on either
# side; and the least.
SHARPNESS, SHARP_DEG, NEAREST = 5.0, 20.0, 2
EVEN_POINTS = 800  # of a sampled rim, besides those at corners
CENTRE_LATTICE = 61  # lines each way of the lattice that is searched for a place well within
CROWDING = 4.0  # of the distances exp(-CROWDING (sqrt n - sqrt j)), j = 1 ... n
SAMPLES_PER_POLE = 3  # of a rim at its corners
SAMPLES = 2048  # of a smooth rim, evenly along its length
LEAST_SAMPLES = 64  # of one side of it
STRAIGHT = 1e-9  # of a side's length, that its points may lie off a straight line
GAUSS_POINTS = 6  # of a part of a curve, between two samples
POINTS_AT_ONCE = 2048  # whose distances from the rim are computed at once
ROUNDING = 1e-12  # of lengths that are sums and quotients of stated ones
MITRE_SHARE = 0.08  # of a side, over which a moved rim is drawn along itself towards a corner


@dataclass(frozen=True)
class RimCurve:
    """A rim through points (x, y) in mm, counter-clockwise: a polygon, or a drawn curve.

    A drawn (`smooth`) rim is a periodic quintic spline by the length of its chords. Its corners are
    the points whose turn is SHARP_DEG or more and SHARPNESS times those beside it; between them
    it is an open spline, and straight between two corners in a row. Raises InputError for points
    that are no simple closed curve.
    """

    points_mm: tuple[tuple[float, float], ...]
    smooth: bool = False

    def __post_init__(self) -> None:
        points = self.points
        count = len(points)
        repeated = np.flatnonzero(np.abs(self.steps) <= 1e-9 * np.abs(self.steps).sum())
        if len(repeated):
            place = f"corner {repeated[0]} at {_text(points[repeated[0]])} twice in a row"
            raise InputError("skin", "outline", place, "every corner once")
        if not self.smooth and count > MOST_CORNERS:
            expected = f'{MOST_CORNERS} corners or fewer, or "smooth": true for a drawn rim'
            raise InputError("skin", "outline", f"{count} corners", expected)
        if len(self.corner_points) > MOST_CORNERS:
            actual = f"{len(self.corner_points)} corners of a drawn rim"
            raise InputError("skin", "outline", actual, f"{MOST_CORNERS} corners or fewer")
        crossing = _crossing(points)
        if crossing is not None:
            sides = "sides {} and {}".format(*crossing)
            raise InputError("skin", "outline", f"{sides} that meet", "a rim that does not cross")
        if abs(self.area_mm2) < LEAST_AREA * self.perimeter_mm**2:
            raise InputError("skin", "outline", "corners on a line", "corners around an area")
        if self.area_mm2 < 0:
            raise InputError("skin", "outline", "clockwise corners", "counter-clockwise ones")

    @cached_property
    def points(self) -> np.ndarray:
        """(K,) complex, mm."""
        x, y = np.array(self.points_mm).T
        return x + 1j * y

    @property
    def steps(self) -> np.ndarray:
        """(K,) complex: from each point to the next."""
        return np.roll(self.points, -1) - self.points

    @cached_property
    def area_mm2(self) -> float:
        """Enclosed area; of a clockwise curve negative."""
        if self.smooth and len(self.corner_points):
            return float(sum(side.area_mm2 for side in self._drawn_sides))
        place, slope, step = self._steps_round
        return float(0.5 * (np.conj(place) * slope).imag.sum() * step)

    @cached_property
    def perimeter_mm(self) -> float:
        """Length of the curve."""
        if not self.smooth:
            return float(np.abs(self.steps).sum())
        if len(self.corner_points):
            return float(sum(side.length_mm for side in self._drawn_sides))
        return self._by_length[1]

    @cached_property
    def corner_points(self) -> np.ndarray:
        """(C,): indices of the points that are corners, ascending."""
        turn_deg = np.degrees(np.abs(self._turns))
        return _sharp(turn_deg) if self.smooth else np.flatnonzero(turn_deg > LEAST_TURN_DEG)

    @cached_property
    def corner_phi(self) -> np.ndarray:
        """(C,): angles of the corners, ascending; none of a smooth rim."""
        if not self.smooth:
            lengths = np.cumsum(np.abs(self.steps))
            starts = np.append(0.0, lengths[:-1])
            return 2.0 * np.pi / lengths[-1] * starts[self.corner_points]
        if not len(self.corner_points):
            return np.zeros(0)
        *before, last = self._drawn_sides
        to_first = last.length_mm - last.reached_mm[len(self.points) - self.corner_points[-1]]
        starts = to_first + np.append(0.0, np.cumsum([side.length_mm for side in before]))
        return 2.0 * np.pi / self.perimeter_mm * starts

    def is_bent(self, phi: np.ndarray) -> np.ndarray:
        """Whether the rim is drawn as a curve at angles phi, and not as a straight side."""
        if not len(self.corner_points) or not self.smooth:
            return np.full(np.shape(phi), self.smooth)
        side, _ = self._side(np.asarray(phi, float) % (2.0 * np.pi))
        return np.array([drawn.bent for drawn in self._drawn_sides])[side]

    def place(self, phi: np.ndarray, order: int = 0) -> np.ndarray:
        """Points of the rim, mm, complex, or their derivative by phi of `order` <= 3."""
        share = np.asarray(phi, float) % (2.0 * np.pi)
        unit = self.perimeter_mm / (2.0 * np.pi)
        if self.smooth and not len(self.corner_points):
            return _complex(self._by_length[0][order](share))
        side, along = self._side(share)
        if self.smooth:
            place = np.zeros(share.shape, complex)
            for index, drawn in enumerate(self._drawn_sides):
                here = side == index
                place[here] = unit**order * drawn.place(along[here], order)
            return place
        direction = (self.steps / np.abs(self.steps))[side]
        if order == 0:
            return self.points[side] + along * direction
        return unit * direction if order == 1 else np.zeros(share.shape, complex)

    def normal(self, phi: np.ndarray, order: int = 0) -> np.ndarray:
        """Unit normal, outwards, complex, or its derivative by phi of `order` <= 2."""
        return -2j * np.pi / self.perimeter_mm * self.place(phi, order + 1)

    def mitre(self, phi: np.ndarray, order: int = 0) -> np.ndarray:
        """What a rim that moves along its normal by 1 moves along itself, or its derivative by phi
        of `order` <= 2: so much at a corner that both sides still meet, and with the distance d
        from it as exp(-(d / MITRE_SHARE side)^2). The shape that a small motion makes does not
        depend on it."""
        share = np.asarray(phi, float) % (2.0 * np.pi)
        if not len(self.corner_points):
            return np.zeros(share.shape)
        unit = self.perimeter_mm / (2.0 * np.pi)
        side, along = self._side(share)
        lengths, turns = self._sides
        length = lengths[side]
        reach = MITRE_SHARE * length
        tangent = np.tan(0.5 * turns)
        rise = -_fade(along / reach, order) * tangent[side]
        fall = (-1.0) ** order * _fade((length - along) / reach, order)
        fall = fall * tangent[(side + 1) % len(tangent)]
        return (unit / reach) ** order * (rise + fall)

    def mitred_normal(self, phi: np.ndarray, order: int = 0) -> np.ndarray:
        """The motion of a rim that moves along its normal by 1: `normal` and `mitre` together, or
        the derivative by phi of `order` <= 2."""
        unit = 2.0 * np.pi / self.perimeter_mm
        binomial = [[1], [1, 1], [1, 2, 1]][order]
        along = sum(
            binomial[n] * self.mitre(phi, n) * unit * self.place(phi, order - n + 1)
            for n in range(order + 1)
        )
        return self.normal(phi, order) + along

    @cached_property
    def centre(self) -> complex:
        """A place well within, and in the middle: of a lattice the point with the largest distance
        from the rim over the root mean square of its distances to the lattice."""
        corners = self._dense
        x, y = (
            np.linspace(part.min(), part.max(), CENTRE_LATTICE + 2)[1:-1]
            for part in (corners.real, corners.imag)
        )
        lattice = (x + 1j * y[:, None]).ravel()
        lattice = lattice[inside(corners, lattice)]
        spread = np.sqrt(np.abs(lattice - lattice.mean()) ** 2 + np.var(lattice))
        return complex(lattice[np.argmax(distance(corners, lattice) / spread)])

    def sampled_phi(
        self, corner_poles: int, even_points: int = EVEN_POINTS
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angles that sample the rim, ascending, evenly and crowded on both sides of corners as so
        many poles do; and indices of the corners among them."""
        even = 2.0 * np.pi * np.arange(even_points) / even_points
        corners = self.corner_phi
        if not len(corners):
            return even, np.zeros(0, int)
        side = np.diff(np.append(corners, corners[0] + 2.0 * np.pi))
        near = 0.5 * crowded(corner_poles, SAMPLES_PER_POLE)[:-1]  # both ends share the middle
        offset = np.abs((even[:, None] - corners + np.pi) % (2.0 * np.pi) - np.pi).min(axis=1)
        parts = [even[offset > 0.5 * even[1]], corners]
        for corner, behind, before in zip(corners, side, np.roll(side, 1), strict=True):
            parts += [corner + near * behind, corner - near * before]
        phi = np.unique(np.concatenate(parts) % (2.0 * np.pi))
        return phi, np.searchsorted(phi, corners % (2.0 * np.pi))

    def lattice(self, count: int) -> np.ndarray:
        """About so many complex places within, mm, on a square lattice that shares out the area."""
        rim = self._dense
        step = float(np.sqrt(self.area_mm2 / count))
        x, y = (
            np.arange(part.min() + 0.5 * step, part.max(), step) for part in (rim.real, rim.imag)
        )
        places = (x + 1j * y[:, None]).ravel()
        return places[self.within(places, 0.3 * step)]

    def lattice_within(self, spacing_mm: float, margin_mm: float) -> np.ndarray:
        """Complex places, mm, `spacing_mm` apart on a square lattice, row by row from below, that
        lie `margin_mm` or more within the rim; in the middle of the rim's extent in x and y."""
        rim = self._dense
        lines = []
        for part in (rim.real, rim.imag):
            room = max(float(np.ptp(part)) - 2.0 * margin_mm, 0.0)
            count = int(room / spacing_mm * (1.0 + ROUNDING)) + 1
            middle = 0.5 * (part.min() + part.max())
            lines.append(middle + spacing_mm * (np.arange(count) - 0.5 * (count - 1)))
        x, y = lines
        places = (x + 1j * y[:, None]).ravel()
        return places[self.within(places, margin_mm - ROUNDING * self.perimeter_mm)]

    def within(self, z: np.ndarray, margin_mm: float) -> np.ndarray:
        """Whether complex points z lie within the rim and farther than `margin_mm` from it."""
        return self.depth(z) > margin_mm

    def depth(self, z: np.ndarray) -> np.ndarray:
        """Distance, mm, of complex points z within the rim from it; outside negative."""
        rim, z = self._dense, np.asarray(z, complex)
        blocks = np.array_split(z.ravel(), z.size // POINTS_AT_ONCE + 1)
        away = np.concatenate([distance(rim, block) for block in blocks]).reshape(z.shape)
        return np.where(inside(rim, z), away, -away)

    def contains(self, z: np.ndarray) -> np.ndarray:
        """Whether complex points z lie within the rim."""
        return inside(self._dense, z)

    def beyond(self, z: np.ndarray) -> np.ndarray:
        """Distance, mm, of complex points z from the skin: 0 within the rim."""
        return np.maximum(-self.depth(z), 0.0)

    def nearest(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of complex points (n,), mm: angles of the nearest points of the rim, and distances."""
        phi, _ = self.sampled_phi(1)
        rim = self.place(phi)
        step = np.roll(rim, -1) - rim
        offset = np.asarray(z)[:, None] - rim
        along = np.clip((offset * np.conj(step)).real / np.abs(step) ** 2, 0.0, 1.0)
        away = np.abs(offset - along * step)
        index, row = away.argmin(axis=1), np.arange(len(away))
        span = (np.roll(phi, -1) - phi) % (2.0 * np.pi)
        return phi[index] + along[row, index] * span[index], away[row, index]

    @cached_property
    def _turns(self) -> np.ndarray:
        """(K,) radians: by how much the direction turns at each point."""
        return np.angle(self.steps / np.roll(self.steps, 1))

    def _side(self, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Side at angles from 0 to 2 pi, and the length along that side."""
        unit = self.perimeter_mm / (2.0 * np.pi)
        if self.smooth:
            side = np.searchsorted(self.corner_phi, share, side="right") - 1
            return side % len(self.corner_phi), unit * (
                (share - self.corner_phi[side]) % (2.0 * np.pi)
            )
        length = share * unit
        ends = np.cumsum(np.abs(self.steps))
        side = np.minimum(np.searchsorted(ends, length, side="right"), len(ends) - 1)
        return side, length - (ends - np.abs(self.steps))[side]

    @cached_property
    def _sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Of each side its length, mm, and by how much the direction turns where it begins."""
        if not self.smooth:
            return np.abs(self.steps), self._turns
        drawn = self._drawn_sides
        lengths = np.array([side.length_mm for side in drawn])
        start = np.array([side.place(0.0, 1) for side in drawn])
        stop = np.array([side.place(side.length_mm, 1) for side in drawn])
        return lengths, np.angle(start / np.roll(stop, 1))

    @cached_property
    def _drawn_sides(self) -> "list[_DrawnSide]":
        """The sides of a drawn rim from its first corner on."""
        corners, count = self.corner_points, len(self.points)
        stops = np.append(corners[1:], corners[0] + count)
        return [
            _drawn_side(self.points[np.arange(start, stop + 1) % count], SAMPLES / count)
            for start, stop in zip(corners, stops, strict=True)
        ]

    @cached_property
    def _dense(self) -> np.ndarray:
        """Points of a polygon that stands for the rim; of a polygon its corners."""
        if self.smooth and len(self.corner_points):
            return np.concatenate([side.dense for side in self._drawn_sides])
        return self._steps_round[0]

    @cached_property
    def _steps_round(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Points of a polygon or of a smooth rim, slopes by a parameter and its step, for areas."""
        if not self.smooth:
            return self.points, self.steps, 1.0
        spline, end = self._spline
        u = end * np.arange(SAMPLES) / SAMPLES
        return _complex(spline(u)), _complex(spline(u, 1)), end / SAMPLES

    @cached_property
    def _spline(self) -> "tuple[BSpline, float]":
        """The spline of (x, y) by chord length, and the length of all chords."""
        chord = np.append(0.0, np.cumsum(np.abs(self.steps)))
        return _periodic_spline(chord, self.points), chord[-1]

    @cached_property
    def _by_length(self) -> "tuple[list[BSpline], float]":
        """Splines of (x, y) and its derivatives by phi, and the length in mm."""
        spline, end = self._spline
        from scipy.interpolate import make_interp_spline

        u = end * np.arange(SAMPLES + 1) / SAMPLES
        node, weight = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        inner = u[:-1, None] + 0.5 * end / SAMPLES * (1.0 + node)
        pieces = 0.5 * end / SAMPLES * np.abs(_complex(spline(inner, 1))) @ weight
        length = np.append(0.0, np.cumsum(pieces))
        share = np.arange(SAMPLES + 1) / SAMPLES
        parameter = make_interp_spline(length, u, k=5)(length[-1] * share)
        curve = _periodic_spline(2.0 * np.pi * share, _complex(spline(parameter[:-1])))
        return [curve, *(curve.derivative(k) for k in (1, 2, 3))], float(length[-1])


class _DrawnSide(NamedTuple):
    """A side of a drawn rim between two corners.

    start: its first point, span: from there to its last; curve: splines of (x, y) by length and
    their derivatives, none of a straight side; reached_mm: the lengths at its points; dense: points
    from its start on, without its end; area_mm2: between it and 0.
    """

    start: complex
    span: complex
    curve: "tuple[BSpline, ...]"
    reached_mm: np.ndarray
    dense: np.ndarray
    area_mm2: float

    @property
    def bent(self) -> bool:
        """Whether it is no straight line."""
        return bool(self.curve)

    @property
    def length_mm(self) -> float:
        """Its length."""
        return float(self.reached_mm[-1])

    def place(self, along_mm: np.ndarray | float, order: int) -> np.ndarray:
        """Complex, mm, at lengths from the start, or the derivative of an order <= 3."""
        if self.bent:
            return _complex(self.curve[order](along_mm))
        along, direction = np.asarray(along_mm), self.span / abs(self.span)
        if order == 0:
            return np.asarray(self.start + along * direction)
        return np.full(along.shape, direction if order == 1 else 0.0)


def _drawn_side(points: np.ndarray, samples: float) -> _DrawnSide:
    """The side through complex points (m + 1,); samples: how many stand for each chord."""
    chord = np.append(0.0, np.cumsum(np.abs(np.diff(points))))
    span = points[-1] - points[0]
    off = np.abs((np.conj(span) * (points - points[0])).imag)
    if off.max() < STRAIGHT * abs(span) ** 2:
        area_mm2 = 0.5 * float((np.conj(points[0]) * span).imag)
        return _DrawnSide(points[0], span, (), chord, points[:1], area_mm2)
    from scipy.interpolate import make_interp_spline

    parts = len(points) - 1
    count = int(np.ceil(max(samples, LEAST_SAMPLES / parts)))
    xy = np.stack([points.real, points.imag], axis=-1)
    spline = make_interp_spline(chord, xy, k=min(5, parts))
    u = np.interp(np.arange(parts * count + 1) / count, np.arange(parts + 1), chord)
    node, weight = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    half = 0.5 * np.diff(u)[:, None]
    inner = u[:-1, None] + half * (1.0 + node)
    step = half * weight * _complex(spline(inner, 1))
    length = np.append(0.0, np.cumsum(np.abs(step).sum(axis=1)))
    even = np.linspace(0.0, length[-1], len(length))
    curve = make_interp_spline(even, spline(make_interp_spline(length, u, k=5)(even)), k=5)
    return _DrawnSide(
        points[0],
        span,
        (curve, *(curve.derivative(k) for k in (1, 2, 3))),
        length[::count],
        _complex(spline(u[:-1])),
        0.5 * float((np.conj(_complex(spline(inner))) * step).imag.sum()),
    )


def _sharp(turn_deg: np.ndarray) -> np.ndarray:
    """Indices of the sharp ones among the turns (K,) of a drawn rim: of a run of turns of SHARP_DEG
    or more those that are SHARPNESS times as large as the NEAREST turns beside the run; none where
    all turns are."""
    sharp = turn_deg >= SHARP_DEG
    while sharp.any() and not sharp.all():
        even = np.flatnonzero(~sharp)
        behind = np.searchsorted(even, np.flatnonzero(sharp))[:, None]
        beside = even[(behind + np.arange(-NEAREST, NEAREST)) % len(even)]
        blunt = turn_deg[sharp] < SHARPNESS * turn_deg[beside].max(axis=1)
        if not blunt.any():
            return np.flatnonzero(sharp)
        sharp[np.flatnonzero(sharp)[blunt]] = False
    return np.zeros(0, int)


def _periodic_spline(parameter: np.ndarray, points: np.ndarray) -> "BSpline":
    """Quintic, of (x, y), through complex points (K,) at parameters (K + 1,), the last where it
    closes."""
    from scipy.interpolate import make_interp_spline

    xy = np.stack([points.real, points.imag], axis=-1)
    return make_interp_spline(parameter, np.vstack([xy, xy[:1]]), k=5, bc_type="periodic")


def _complex(xy: np.ndarray) -> np.ndarray:
    """x + i y of (..., 2)."""
    return xy[..., 0] + 1j * xy[..., 1]


def crowded(count: int, per_step: int = 1) -> np.ndarray:
    """(count per_step,): ascending shares of a reach, the last 1, that crowd at 0 as poles at a
    corner do (Gopal, Trefethen 2019, SIAM J. Numer. Anal. 57:2074)."""
    step = np.arange(1, count * per_step + 1) / per_step
    return np.exp(-CROWDING * (np.sqrt(count) - np.sqrt(step)))


def inside(corners: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Whether complex points z lie within a polygon with complex corners (K,)."""
    z = np.asarray(z, complex)
    within = np.zeros(z.shape, bool)
    for start, stop in zip(corners, np.roll(corners, -1), strict=True):
        spans = (start.imag > z.imag) != (stop.imag > z.imag)
        if spans.any():
            rise = (z.imag[spans] - start.imag) / (stop.imag - start.imag)
            crossing = start.real + rise * (stop.real - start.real)
            within[spans] ^= z.real[spans] < crossing
    return within


def distance(corners: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Distance of complex points z from a polygon with complex corners (K,)."""
    step = np.roll(corners, -1) - corners
    offset = np.asarray(z)[..., None] - corners
    along = np.clip((offset * np.conj(step)).real / np.abs(step) ** 2, 0.0, 1.0)
    return np.abs(offset - along * step).min(axis=-1)


def _fade(x: np.ndarray, order: int) -> np.ndarray:
    """exp(-x^2), or its derivative of `order` <= 2."""
    factor = (1.0, -2.0 * x, 4.0 * x**2 - 2.0)[order]
    return factor * np.exp(-(x**2))


def _crossing(points: np.ndarray) -> tuple[int, int] | None:
    """Two sides of a closed polygon that meet without being neighbours; None for none."""
    count = len(points)
    start, step = points, np.roll(points, -1) - points
    for i in range(count - 2):
        others = np.arange(i + 2, count - (i == 0))
        if not len(others):
            continue
        offset = start[others] - start[i]
        cross = (np.conj(step[i]) * step[others]).imag
        with np.errstate(divide="ignore", invalid="ignore"):
            here = (np.conj(offset) * step[others]).imag / cross
            there = (np.conj(offset) * step[i]).imag / cross
        meet = (here >= 0) & (here <= 1) & (there >= 0) & (there <= 1)
        if meet.any():
            return i, int(others[np.argmax(meet)])
    return None


def _text(point: complex) -> str:
    return f"({point.real:g}, {point.imag:g}) mm"
