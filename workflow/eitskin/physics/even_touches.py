"""Touches with even nodes, several at once: as TouchEdge computes one, without the overhead."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.arrays import as_in
from eitskin.physics.conformal import DiscMap
from eitskin.physics.geometry import Geometry
from eitskin.physics.harmonics import EXTRA_MOMENTS, Harmonics, RimField, symmetric
from eitskin.physics.touch import MOST_EVEN_NODES, Circle, TouchAccuracy, even_nodes
from eitskin.physics.touch_cache import Place

BATCH_BYTES = 1 << 19  # of the largest array of one batch, so that it stays in a core's cache


class EvenTouches:
    """Several touches with equally many multipoles and even nodes, as TouchEdge is one.

    mass, self_response (P, 2 degree, 2 degree).
    """

    def __init__(self, circles: Circle, degree: int, count: int):
        t, weight = (as_in(values, circles.radius) for values in even_nodes(count))
        zeta, tangent, curvature = circles.mapped(t, 2)
        dzeta = tangent * weight
        harmonics = Harmonics.around(zeta, degree)
        values = harmonics.values(zeta)
        kernel = neumann.self_flux_kernel(zeta, tangent, curvature, weight, jump=-0.5)
        across = harmonics.flux(zeta, dzeta).mT
        self.mass = symmetric(across @ values)
        self.self_response = self.mass + symmetric(across @ (kernel @ values))
        self.field = RimField(harmonics, zeta, dzeta, values)

    def rim_response(self, rim: np.ndarray) -> np.ndarray:
        """(P, points, 2 degree): as TouchEdge's; rim (points,), or each touch's own (P, points)."""
        return self.field.potential(rim)

    def response_within(self, zeta: np.ndarray) -> np.ndarray:
        """(P, points, 2 degree): as TouchEdge's, at points (points,)."""
        nodes, dzeta = (a[:, None, :] for a in (self.field.zeta, self.field.dzeta))
        return neumann.flux_kernel(zeta[:, None], nodes, dzeta) @ self.field.values


def by_resolution(gaps: np.ndarray, accuracy: TouchAccuracy) -> dict[tuple[int, int], np.ndarray]:
    """Indices (K,) of the touches that have even nodes, by multipoles and nodes (degree, count);
    gaps (P,) to the rim, in radii."""
    touches: dict[tuple[int, int], list[int]] = {}
    for i, gap in enumerate(gaps.tolist()):
        for_rim = accuracy.across(gap)
        if gap >= accuracy.rim_gap and for_rim <= MOST_EVEN_NODES:
            touches.setdefault(accuracy.resolution(for_rim), []).append(i)
    return {resolution: np.array(indices) for resolution, indices in touches.items()}


def touches_per_batch(nbytes: int, degree: int, count: int, rim_points: int) -> int:
    """How many touches with so many multipoles and nodes fit in one batch, whose largest array
    has at most `nbytes`."""
    touch_bytes = max(16 * count**2, 16 * rim_points * (degree + EXTRA_MOMENTS))
    return max(nbytes // touch_bytes, 1)


def even_touches(
    places: Sequence[Place],
    geometry: Geometry,
    disc: DiscMap,
    accuracy: TouchAccuracy,
    electrodes: Any,
) -> Iterator[tuple[list[Place], EvenTouches]]:
    """Yield the places whose touches have even nodes, batch by batch, with their EvenTouches;
    electrodes: an Electrodes on which each acts. Raises InputError as its `clearance`."""
    places = [place for place in places if place[2] > 0]
    if not places:
        return
    x, y, radius = np.array(places).T[:, :, None]
    circles = Circle(x + 1j * y, radius, geometry, disc)
    gaps = np.minimum(circles.rim_gaps(), electrodes.clearance(circles))
    for (degree, count), indices in by_resolution(gaps, accuracy).items():
        batch = touches_per_batch(BATCH_BYTES, degree, count, len(electrodes.nodes))
        for start in range(0, len(indices), batch):
            selection = indices[start : start + batch]
            yield (
                [places[i] for i in selection],
                EvenTouches(circles.select(selection), degree, count),
            )
