"""Touches with even nodes, several at once: the same as one by one, without the overhead."""

from collections.abc import Iterator, Sequence

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.conformal import DiscMap
from eitskin.physics.geometry import Geometry
from eitskin.physics.harmonics import Harmonics, symmetric
from eitskin.physics.kept_touches import Place
from eitskin.physics.touch import MOST_EVEN_NODES, ROUND, Circle, TouchAccuracy, even_nodes, rim_gap

AT_ONCE_BYTES = 1 << 19  # of an array between nodes and rim: what a core's cache may hold


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
        self.zeta, tangent, curvature = _circles(places, geometry, disc).mapped(t, 2)
        self.dzeta = tangent * weight
        harmonics = Harmonics.around(self.zeta, degree)
        self.values = harmonics.values(self.zeta)
        kernel = neumann.own_flux_kernel(self.zeta, tangent, curvature, weight, jump=-0.5)
        across = np.swapaxes(harmonics.flux(self.zeta, self.dzeta), -1, -2)
        self.mass = symmetric(across @ self.values)
        self.self_response = self.mass + symmetric(across @ (kernel @ self.values))

    def rim_response(self, rim: np.ndarray) -> np.ndarray:
        """(P, points, 2 degree): as TouchEdge's."""
        kernel = neumann.rim_flux_kernel(
            rim[:, None], self.zeta[:, None, :], self.dzeta[:, None, :]
        )
        return kernel @ self.values


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
    gaps = rim_gap(_circles(places, geometry, disc).mapped(ROUND, 0)[0])
    for place, gap in zip(places, gaps, strict=True):
        for_rim = accuracy.across(gap)
        if gap >= accuracy.rim_gap and for_rim <= MOST_EVEN_NODES:
            alike.setdefault(accuracy.resolution(for_rim), []).append(place)
    for (degree, count), own in alike.items():
        most = max(AT_ONCE_BYTES // (16 * count * max(count, rim_points)), 1)
        for start in range(0, len(own), most):
            yield EvenTouches(own[start : start + most], geometry, disc, degree, count)


def _circles(places: Sequence[Place], geometry: Geometry, disc: DiscMap) -> Circle:
    x, y, radius = np.array(places).T[:, :, None]
    return Circle(x + 1j * y, radius, geometry, disc)
