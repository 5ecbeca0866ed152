"""Unstructured meshes of a skin: triangles that follow its rim, its electrodes' ends and circles.

Delaunay's triangulation of the curves' nodes, refined by circumcentres until every triangle is as
small as is wanted where it lies and none is thin (Chew 1989, Ruppert 1995); curves are never
split. Complex places in units of the skin's radius.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree

SLOPE = 1.0  # the wanted size grows with the distance from what asks for small triangles
THIN = 1.5  # circumradius over shortest side
ROUNDS = 60


@dataclass(frozen=True)
class Curve:
    """A closed curve, its place and speed |dz/dphi| by the angle, and angles that must be nodes."""

    place: Callable[[np.ndarray], np.ndarray]
    speed: Callable[[np.ndarray], np.ndarray]
    fixed: np.ndarray

    def nodes(self, size: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Ascending angles of nodes, as near to each other as `size` at places wants."""
        ends = np.unique(self.fixed % (2.0 * np.pi))
        found = []
        for start, stop in zip(ends, np.append(ends[1:], ends[0] + 2.0 * np.pi), strict=True):
            # Fine where the ends are: the wanted size may be tiny there.
            t = np.linspace(0.0, 1.0, 2001)
            phi = start + (stop - start) * (t * t * (3.0 - 2.0 * t))
            steps = self.speed(phi) / size(self.place(phi))
            count = np.append(0.0, np.cumsum(0.5 * (steps[1:] + steps[:-1]) * np.diff(phi)))
            whole = max(1, int(np.ceil(count[-1])))
            found.append(np.interp(count[-1] * np.arange(whole) / whole, count, phi))
        return np.concatenate(found)


@dataclass(frozen=True)
class Sizes:
    """Wanted sides of triangles: near[k] at at[k], growing by SLOPE with the distance, `most` at
    the most."""

    at: np.ndarray
    near: np.ndarray
    most: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Wanted side at places x."""
        wanted = np.full(x.shape, self.most)
        for at, near in zip(self.at, self.near, strict=True):
            wanted = np.minimum(wanted, near + SLOPE * np.abs(x - at))
        return wanted


@dataclass(frozen=True)
class Mesh:
    """place (P,); corners (T, 3); of each curve its nodes (K,), in order, and the nodes' angles
    (K + 1,), the last one turn after the first."""

    place: np.ndarray
    corners: np.ndarray
    nodes: list[np.ndarray]
    angles: list[np.ndarray]


def _circumcentre(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    u, v = b - a, c - a
    cross = 2.0 * (np.conj(u) * v).imag
    return a + 1j * (v * np.abs(u) ** 2 - u * np.abs(v) ** 2) * -1.0 / cross


def _kept(place: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(T, 3) triangles of all places that lie within the rim, its nodes `rim` in order."""
    corners = Delaunay(np.column_stack([place.real, place.imag])).simplices
    a, b, c = place[corners].T
    area = 0.5 * (np.conj(b - a) * (c - a)).imag
    corners[area < 0] = corners[area < 0][:, [0, 2, 1]]
    rank = np.full(len(place), -1)
    rank[rim] = np.arange(len(rim))
    at = np.sort(rank[corners], axis=1)
    # All three corners on the rim: within it where the rim's polygon, anticlockwise, turns so.
    on_rim = at[:, 0] >= 0
    p, q, r = place[rim[at]].T
    outside = on_rim & ((np.conj(q - p) * (r - p)).imag <= 1e-14)
    return corners[~outside]


def _missing(corners: np.ndarray, nodes: list[np.ndarray], count: int) -> int:
    """How many of the curves' sides are no triangle's."""
    sides = np.sort(np.vstack([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    have = set((sides[:, 0] * count + sides[:, 1]).tolist())
    lacking = 0
    for curve in nodes:
        pairs = np.sort(np.column_stack([curve, np.roll(curve, -1)]), axis=1)
        lacking += len(set((pairs[:, 0] * count + pairs[:, 1]).tolist()) - have)
    return lacking


def _on_curves(
    curves: list[Curve], angles: list[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Places (P,) of the curves' nodes at their angles, those where curves meet once; of each curve
    its nodes (K,) among them."""
    place = np.zeros(0, complex)
    nodes = []
    for curve, phi in zip(curves, angles, strict=True):
        at = curve.place(phi)
        index = np.arange(len(place), len(place) + len(at))
        if len(place):
            apart, same = cKDTree(np.column_stack([place.real, place.imag])).query(
                np.column_stack([at.real, at.imag])
            )
            met = apart < 1e-12
            index = np.where(met, same, len(place) + np.cumsum(~met) - 1)
            at = at[~met]
        nodes.append(index)
        place = np.concatenate([place, at])
    return place, nodes


def triangulate(
    curves: list[Curve],
    size: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray | None = None,
    rim: np.ndarray | None = None,
) -> Mesh:
    """The mesh within the first curve, the rim; others lie inside it and may cross at `fixed`.

    size: the wanted side of a triangle at places; start: places within the rim to begin with,
    kept where they are far enough from the curves; rim: the angles of the rim's nodes. Raises
    ValueError where no mesh follows all curves.
    """
    angles = [curve.nodes(size) for curve in curves[1:]]
    angles.insert(0, curves[0].nodes(size) if rim is None else rim)
    place, nodes = _on_curves(curves, angles)
    fixed = len(place)
    sides = [(place[curve], place[np.roll(curve, -1)]) for curve in nodes]
    middle = np.concatenate([0.5 * (a + b) for a, b in sides])
    half = np.concatenate([0.5 * np.abs(a - b) for a, b in sides])
    tree = cKDTree(np.column_stack([middle.real, middle.imag]))
    widest = half.max()
    if start is not None:
        close = tree.query(np.column_stack([start.real, start.imag]))
        clear = close[0] > np.maximum(1.1 * half[close[1]], 0.5 * size(start))
        place = np.concatenate([place, start[clear]])
    for _ in range(ROUNDS):
        corners = _kept(place, nodes[0])
        a, b, c = place[corners].T
        centre = _circumcentre(a, b, c)
        radius = np.abs(centre - a)
        shortest = np.minimum(np.minimum(np.abs(a - b), np.abs(b - c)), np.abs(c - a))
        bad = np.maximum(radius / (0.62 * size((a + b + c) / 3.0)), radius / shortest / THIN)
        worst = np.flatnonzero(bad > 1.0)
        worst = worst[np.argsort(-radius[worst], kind="stable")]
        chosen = centre[worst]
        # None within the circle over a curve's side: it would hide the side.
        spots = np.column_stack([chosen.real, chosen.imag])
        free = np.ones(len(chosen), bool)
        for i, close in enumerate(tree.query_ball_point(spots, widest)):
            free[i] = np.all(np.abs(chosen[i] - middle[close]) > 1.02 * half[close])
        free &= _within(chosen, place[nodes[0]])
        chosen, reach = chosen[free], radius[worst][free]
        new = _apart(chosen, 0.9 * reach)
        if not len(new):
            break
        place = np.concatenate([place, new])
    place = _smoothed(place, corners, fixed)
    corners = _kept(place, nodes[0])
    lacking = _missing(corners, nodes, len(place))
    if lacking:
        raise ValueError(f"no mesh follows the curves: {lacking} sides are missing")
    turns = [np.append(phi, phi[0] + 2.0 * np.pi) for phi in angles]
    return Mesh(place, corners, nodes, turns)


def _within(x: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Whether places x lie within a polygon that is a star about 0."""
    angle = np.angle(rim)
    order = np.argsort(angle)
    angle, rim = angle[order], rim[order]
    k = np.searchsorted(angle, np.angle(x)) % len(rim)
    a, b = rim[k - 1], rim[k]
    return (np.conj(b - a) * (x - a)).imag > 0


def _apart(x: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Of places x, in order, those that none before is within `reach` of."""
    if not len(x):
        return x
    tree = cKDTree(np.column_stack([x.real, x.imag]))
    close = tree.query_ball_point(np.column_stack([x.real, x.imag]), reach)
    taken = np.ones(len(x), bool)
    for i, others in enumerate(close):
        if taken[i]:
            later = [k for k in others if k > i]
            taken[later] = False
    return x[taken]


def _smoothed(place: np.ndarray, corners: np.ndarray, fixed: int) -> np.ndarray:
    """Free places moved towards the mean of their neighbours, where no triangle gets thinner
    than the thinnest was."""
    sides = np.vstack([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0)
    for _ in range(3):
        total, count = np.zeros(len(place), complex), np.zeros(len(place))
        for i, j in (sides.T, sides.T[::-1]):
            np.add.at(total, i, place[j])
            np.add.at(count, i, 1.0)
        moved = place.copy()
        moved[fixed:] = 0.5 * (place[fixed:] + total[fixed:] / count[fixed:])
        spoiled = _quality(moved, corners) < np.minimum(0.5, _quality(place, corners))
        stay = np.unique(corners[spoiled])
        moved[stay] = place[stay]
        if (_quality(moved, corners) <= 0.0).any():
            break
        place = moved
    return place


def _quality(place: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Twice the inradius over the circumradius with the orientation's sign, 1 at best."""
    a, b, c = place[corners].T
    x, y, z = np.abs(b - a), np.abs(c - b), np.abs(a - c)
    area = 0.5 * (np.conj(b - a) * (c - a)).imag
    return 16.0 * area * np.abs(area) / (x * y * z * (x + y + z))
