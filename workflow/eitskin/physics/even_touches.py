"""Touches with even nodes, several at once: the same as one by one, without the overhead."""

from collections.abc import Iterator, Sequence

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.arrays import as_in
from eitskin.physics.conformal import DiscMap
from eitskin.physics.geometry import Geometry
from eitskin.physics.harmonics import MORE, Harmonics, RimField, symmetric
from eitskin.physics.kept_touches import Place
from eitskin.physics.touch import MOST_EVEN_NODES, Circle, TouchAccuracy, even_nodes

AT_ONCE_BYTES = 1 << 19  # of the largest array of touches found together


class EvenTouches:
    """Several touches, of as many multipoles and even nodes each: as TouchEdge is one.

    mass, self_response (P, 2 degree, 2 degree).
    """

    def __init__(self, circles: Circle, degree: int, count: int):
        t, weight = (as_in(values, circles.radius) for values in even_nodes(count))
        zeta, tangent, curvature = circles.mapped(t, 2)
        dzeta = tangent * weight
        harmonics = Harmonics.around(zeta, degree)
        values = harmonics.values(zeta)
        kernel = neumann.own_flux_kernel(zeta, tangent, curvature, weight, jump=-0.5)
        across = harmonics.flux(zeta, dzeta).mT
        self.mass = symmetric(across @ values)
        self.self_response = self.mass + symmetric(across @ (kernel @ values))
        self.field = RimField(harmonics, zeta, dzeta, values)

    def rim_response(self, rim: np.ndarray) -> np.ndarray:
        """(P, points, 2 degree): as TouchEdge's; rim (points,), or each touch's own (P, points)."""
        return self.field.at(rim)


def alike(gaps: np.ndarray, accuracy: TouchAccuracy) -> dict[tuple[int, int], np.ndarray]:
    """The touches (K,) of gaps (P,) to the rim that have even nodes, by multipoles and nodes."""
    found: dict[tuple[int, int], list[int]] = {}
    for i, gap in enumerate(gaps.tolist()):
        for_rim = accuracy.across(gap)
        if gap >= accuracy.rim_gap and for_rim <= MOST_EVEN_NODES:
            found.setdefault(accuracy.resolution(for_rim), []).append(i)
    return {resolution: np.array(own) for resolution, own in found.items()}


def together(nbytes: int, degree: int, count: int, rim_points: int) -> int:
    """How many touches of so many multipoles and nodes are found together, their largest array of
    at most so many bytes."""
    each = max(16 * count**2, 16 * rim_points * (degree + MORE))
    return max(nbytes // each, 1)


def even_touches(
    places: Sequence[Place],
    geometry: Geometry,
    disc: DiscMap,
    accuracy: TouchAccuracy,
    rim_points: int,
) -> Iterator[tuple[list[Place], EvenTouches]]:
    """Those of the places whose touches have even nodes, some at once: as many as a core's cache
    holds, with so many rim points to act on."""
    places = [place for place in places if place[2] > 0]
    if not places:
        return
    x, y, radius = np.array(places).T[:, :, None]
    circles = Circle(x + 1j * y, radius, geometry, disc)
    for (degree, count), own in alike(circles.rim_gaps(), accuracy).items():
        most = together(AT_ONCE_BYTES, degree, count, rim_points)
        for start in range(0, len(own), most):
            some = own[start : start + most]
            yield [places[i] for i in some], EvenTouches(circles.only(some), degree, count)
