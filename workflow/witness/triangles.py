"""Unstructured meshes of a skin: triangles that follow its rim, its electrodes' ends and circles.

Delaunay triangulation of the curves' nodes, refined by circumcentres until every triangle has the
size wanted at its place and none is thin (Chew 1989, Ruppert 1995); a curve's sides are halved only
where no triangle has them. Complex places in units of the skin's radius.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay, cKDTree

SLOPE = 1.0  # growth of the wanted size with the distance from a fine region
THIN = 1.5  # circumradius over shortest side, above which a triangle is refined
HALVINGS = 8  # of the sides that no triangle has, at most
ROUNDS = 60  # of refinement at most; a mesh needs some twenty
COINCIDENT = 1e-12  # the distance of nodes that are the same


@dataclass(frozen=True)
class Curve:
    """A curve, its place and speed |dz/dphi| by the angle, and angles that must be nodes.

    It is closed, of period 2 pi, or, where it is an arc, goes from its least fixed angle to its
    largest.
    """

    place: Callable[[np.ndarray], np.ndarray]
    speed: Callable[[np.ndarray], np.ndarray]
    fixed: np.ndarray
    is_arc: bool = False

    def nodes(self, size: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """(K + 1,): ascending angles of nodes with distances `size` at their places; the last is an
        arc's end, or one turn after the first."""
        ends = np.unique(self.fixed if self.is_arc else self.fixed % (2.0 * np.pi))
        if not self.is_arc:
            ends = np.append(ends, ends[0] + 2.0 * np.pi)
        ends = ends[np.append(True, np.diff(ends) > COINCIDENT)]
        angles = []
        for start, stop in pairwise(ends):
            # Fine towards the ends, where the wanted size may be tiny.
            t = np.linspace(0.0, 1.0, 2001)
            phi = start + (stop - start) * (t * t * (3.0 - 2.0 * t))
            steps = self.speed(phi) / size(self.place(phi))
            count = np.append(0.0, np.cumsum(0.5 * (steps[1:] + steps[:-1]) * np.diff(phi)))
            panel_count = max(1, int(np.ceil(count[-1])))
            angles.append(np.interp(count[-1] * np.arange(panel_count) / panel_count, count, phi))
        return np.concatenate([*angles, ends[-1:]])


@dataclass(frozen=True)
class Sizes:
    """Wanted sides of triangles: sides[k] at points[k], growing by `slope` with the distance up to
    `max_size`."""

    points: np.ndarray
    sides: np.ndarray
    max_size: float
    slope: float = SLOPE

    def reduced(self) -> "Sizes":
        """The same sizes everywhere, without points at which another asks for as short a side."""
        chosen: list[int] = []
        for k in np.argsort(self.sides, kind="stable"):
            apart = np.abs(self.points[chosen] - self.points[k])
            shortest = (self.sides[chosen] + self.slope * apart).min(initial=self.max_size)
            if self.sides[k] < shortest:
                chosen.append(int(k))
        return Sizes(self.points[chosen], self.sides[chosen], self.max_size, self.slope)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The wanted side at places x."""
        sides = np.full(x.shape, self.max_size)
        for point, side in zip(self.points, self.sides, strict=True):
            sides = np.minimum(sides, side + self.slope * np.abs(x - point))
        return sides


@dataclass(frozen=True)
class Mesh:
    """place (P,); corners (T, 3); of each curve its nodes (K + 1,), in order, and their angles; of
    a closed curve the last is the first, one turn later."""

    place: np.ndarray
    corners: np.ndarray
    nodes: list[np.ndarray]
    angles: list[np.ndarray]


def _circumcentre(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    u, v = b - a, c - a
    cross = 2.0 * (np.conj(u) * v).imag
    return a + 1j * (v * np.abs(u) ** 2 - u * np.abs(v) ** 2) * -1.0 / cross


def _triangles_within(place: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(T, 3): the triangles of all places within the rim, whose nodes are `rim` in order."""
    corners = Delaunay(np.column_stack([place.real, place.imag])).simplices
    a, b, c = place[corners].T
    area = 0.5 * (np.conj(b - a) * (c - a)).imag
    corners[area < 0] = corners[area < 0][:, [0, 2, 1]]
    rank = np.full(len(place), -1)
    rank[rim] = np.arange(len(rim))
    rim_rank = np.sort(rank[corners], axis=1)
    # All three corners on the rim: within it where the rim's polygon, anticlockwise, turns so.
    on_rim = rim_rank[:, 0] >= 0
    p, q, r = place[rim[rim_rank]].T
    outside = on_rim & ((np.conj(q - p) * (r - p)).imag <= 1e-14)
    return corners[~outside]


def _missing_sides(corners: np.ndarray, nodes: list[np.ndarray], count: int) -> list[np.ndarray]:
    """(K,): of every curve, whether its sides are not sides of a triangle."""
    sides = np.sort(np.vstack([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    have = np.unique(sides[:, 0] * count + sides[:, 1])
    lacking = []
    for curve in nodes:
        pairs = np.sort(np.column_stack([curve[:-1], curve[1:]]), axis=1)
        lacking.append(~np.isin(pairs[:, 0] * count + pairs[:, 1], have))
    return lacking


def _on_curves(
    curves: list[Curve], angles: list[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The places (P,) of the curves' nodes at their angles, with common nodes once, and the nodes
    (K + 1,) of each curve among them."""
    place = np.zeros(0, complex)
    nodes = []
    for curve, phi in zip(curves, angles, strict=True):
        curve_places = curve.place(phi if curve.is_arc else phi[:-1])
        index = np.arange(len(place), len(place) + len(curve_places))
        if len(place):
            distance, nearest_node = cKDTree(np.column_stack([place.real, place.imag])).query(
                np.column_stack([curve_places.real, curve_places.imag])
            )
            is_shared = distance < COINCIDENT
            index = np.where(is_shared, nearest_node, len(place) + np.cumsum(~is_shared) - 1)
            curve_places = curve_places[~is_shared]
        nodes.append(index if curve.is_arc else np.append(index, index[0]))
        place = np.concatenate([place, curve_places])
    return place, nodes


def triangulate(
    curves: list[Curve],
    size: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray | None = None,
    rim: np.ndarray | None = None,
) -> Mesh:
    """The mesh within the first curve, the rim; others lie inside it and may cross at `fixed`.

    size: the wanted side of a triangle at places; start: initial places within the rim, used where
    they are far enough from the curves; rim: the angles (K + 1,) of the rim's nodes,
    to which none is added. Raises ValueError where no mesh follows all curves.
    """
    angles = [curve.nodes(size) for curve in curves[1:]]
    angles.insert(0, curves[0].nodes(size) if rim is None else rim)
    for _ in range(HALVINGS):
        place, nodes = _on_curves(curves, angles)
        place, corners = _refined(place, nodes, size, start)
        missing = _missing_sides(corners, nodes, len(place))
        lacking = sum(int(sides.sum()) for sides in missing)
        if not lacking:
            return Mesh(place, corners, nodes, angles)
        if rim is not None and missing[0].any():
            break
        for k, sides in enumerate(missing):
            middle = 0.5 * (angles[k][1:] + angles[k][:-1])
            angles[k] = np.sort(np.append(angles[k], middle[sides]))
    raise ValueError(f"no mesh follows the curves: {lacking} sides are missing")


def _refined(
    place: np.ndarray,
    nodes: list[np.ndarray],
    size: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Places (P,), those on curves first, and triangles (T, 3) of the wanted sizes."""
    fixed = len(place)
    rim_nodes = nodes[0][:-1]
    sides = [(place[curve[:-1]], place[curve[1:]]) for curve in nodes]
    middle = np.concatenate([0.5 * (a + b) for a, b in sides])
    half = np.concatenate([0.5 * np.abs(a - b) for a, b in sides])
    tree = cKDTree(np.column_stack([middle.real, middle.imag]))
    widest = half.max()
    if start is not None:
        nearest = tree.query(np.column_stack([start.real, start.imag]))
        clear = nearest[0] > np.maximum(1.1 * half[nearest[1]], 0.5 * size(start))
        place = np.concatenate([place, start[clear]])
    for _ in range(ROUNDS):
        corners = _triangles_within(place, rim_nodes)
        a, b, c = place[corners].T
        centre = _circumcentre(a, b, c)
        radius = np.abs(centre - a)
        shortest = np.minimum(np.minimum(np.abs(a - b), np.abs(b - c)), np.abs(c - a))
        bad = np.maximum(radius / (0.62 * size((a + b + c) / 3.0)), radius / shortest / THIN)
        worst = np.flatnonzero(bad > 1.0)
        worst = worst[np.argsort(-radius[worst], kind="stable")]
        centres = centre[worst]
        # No centre within the circle over a curve's side, as it would remove the side.
        spots = np.column_stack([centres.real, centres.imag])
        free = np.ones(len(centres), bool)
        for i, nearest in enumerate(tree.query_ball_point(spots, widest)):
            free[i] = np.all(np.abs(centres[i] - middle[nearest]) > 1.02 * half[nearest])
        free &= within(centres, place[rim_nodes])
        centres, reach = centres[free], radius[worst][free]
        new = _well_separated(centres, 0.9 * reach)
        if not len(new):
            break
        place = np.concatenate([place, new])
    place = _smoothed(place, corners, fixed)
    corners = _triangles_within(place, rim_nodes)
    return place, corners


def within(x: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Whether places x (N,) lie within a polygon with corners `rim`, by the parity of the sides
    that a ray to the right meets."""
    is_inside = np.zeros(len(x), bool)
    for a, b in zip(rim, np.roll(rim, -1), strict=True):
        meets = (a.imag > x.imag) != (b.imag > x.imag)
        is_left = ((b - a).conjugate() * (x - a)).imag * (b.imag - a.imag) > 0
        is_inside ^= meets & is_left
    return is_inside


def _well_separated(x: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """The places x, in order, without those within `reach` of an earlier accepted one."""
    if not len(x):
        return x
    tree = cKDTree(np.column_stack([x.real, x.imag]))
    close = tree.query_ball_point(np.column_stack([x.real, x.imag]), reach)
    is_accepted = np.ones(len(x), bool)
    for i, neighbours in enumerate(close):
        if is_accepted[i]:
            later = [k for k in neighbours if k > i]
            is_accepted[later] = False
    return x[is_accepted]


def _smoothed(place: np.ndarray, corners: np.ndarray, fixed: int) -> np.ndarray:
    """Free places moved towards the mean of their neighbours, unless a triangle's quality would
    fall below its present value and 0.5."""
    sides = np.vstack([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0)
    for _ in range(3):
        total, count = np.zeros(len(place), complex), np.zeros(len(place))
        for i, j in (sides.T, sides.T[::-1]):
            np.add.at(total, i, place[j])
            np.add.at(count, i, 1.0)
        smoothed = place.copy()
        smoothed[fixed:] = 0.5 * (place[fixed:] + total[fixed:] / count[fixed:])
        spoiled = _quality(smoothed, corners) < np.minimum(0.5, _quality(place, corners))
        kept_nodes = np.unique(corners[spoiled])
        smoothed[kept_nodes] = place[kept_nodes]
        if (_quality(smoothed, corners) <= 0.0).any():
            break
        place = smoothed
    return place


def _quality(place: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Twice the inradius over the circumradius, with the sign of the orientation; at most 1."""
    a, b, c = place[corners].T
    x, y, z = np.abs(b - a), np.abs(c - b), np.abs(a - c)
    area = 0.5 * (np.conj(b - a) * (c - a)).imag
    return 16.0 * area * np.abs(area) / (x * y * z * (x + y + z))
