"""Touches with even nodes, several at once: the same as one by one, without the overhead."""

from collections.abc import Iterator, Sequence

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.conformal import DiscMap
from eitskin.physics.geometry import Geometry
from eitskin.physics.harmonics import Harmonics, RimMoments, symmetric
from eitskin.physics.kept_touches import Place
from eitskin.physics.touch import MOST_EVEN_NODES, Circle, TouchAccuracy, even_nodes, rim_gaps

AT_ONCE_BYTES = 1 << 20  # of an array between nodes and rim: what a core's cache may hold


class EvenTouches:
    """Several touches, at `places`, of as many multipoles and even nodes each: as TouchEdge is one.

    mass, self_response (P, 2 degree, 2 degree).
    """

    def __init__(
        self,
        places: Sequence[Place],
        geometry: Geometry,
        disc: DiscMap,
        degree: int,
        count: int,
    ):
        self.places = places
        t, weight = even_nodes(count)
        x, y, radius = np.array(places).T[:, :, None]
        zeta, tangent, curvature = Circle(x + 1j * y, radius, geometry, disc).mapped(t, 2)
        dzeta = tangent * weight
        harmonics = Harmonics.around(zeta, degree)
        values = harmonics.values(zeta)
        kernel = neumann.own_flux_kernel(zeta, tangent, curvature, weight, jump=-0.5)
        across = np.swapaxes(harmonics.flux(zeta, dzeta), -1, -2)
        self.mass = symmetric(across @ values)
        self.self_response = self.mass + symmetric(across @ (kernel @ values))
        self.moments = RimMoments.of(harmonics, zeta, dzeta, values)

    def rim_response(self, rim: np.ndarray) -> np.ndarray:
        """(P, points, 2 degree): as TouchEdge's."""
        return self.moments.at(rim)


def even_touches(
    places: Sequence[Place],
    geometry: Geometry,
    disc: DiscMap,
    accuracy: TouchAccuracy,
    rim_points: int,
) -> Iterator[EvenTouches]:
    """Those of the places whose touches have even nodes, some at once: as many as are to act on so
    many rim points from a core's cache."""
    places = [place for place in places if place[2] > 0]
    if not places:
        return
    alike: dict[tuple[int, int], list[Place]] = {}
    x, y, radius = np.array(places).T
    gaps = rim_gaps(x + 1j * y, radius, geometry, disc)
    for place, gap in zip(places, gaps, strict=True):
        for_rim = accuracy.across(gap)
        if gap >= accuracy.rim_gap and for_rim <= MOST_EVEN_NODES:
            alike.setdefault(accuracy.resolution(for_rim), []).append(place)
    for (degree, count), own in alike.items():
        most = max(AT_ONCE_BYTES // (16 * count * max(count, rim_points)), 1)
        for start in range(0, len(own), most):
            yield EvenTouches(own[start : start + most], geometry, disc, degree, count)
