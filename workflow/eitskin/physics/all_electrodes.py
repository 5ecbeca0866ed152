"""All electrodes of a skin, on its rim and inside."""

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.conformal import DiscMap
from eitskin.physics.covered_electrodes import CoveredElectrodes, covered_electrodes
from eitskin.physics.electrodes import Electrodes
from eitskin.physics.geometry import Geometry
from eitskin.physics.inner_electrodes import InnerElectrodes
from eitskin.physics.rim_curve import distance
from eitskin.physics.touch import Circle, TouchAccuracy, TouchEdge
from eitskin.physics.touch_cache import Place


class RimAndInnerElectrodes:
    """All electrodes of a skin with some, or all, of them inside, with the interface of Electrodes.

    Nodes and modes are those on the rim, then those inside; whole (n,): the modes of the
    electrodes' whole currents.
    """

    def __init__(
        self,
        geometry: Geometry,
        disc: DiscMap,
        order: int,
        accuracy: TouchAccuracy,
        inner_orders: int | None = None,
    ):
        """`inner_orders`: angular orders of the electrodes inside, by default those needed."""
        self.geometry, self.disc, self.order = geometry, disc, order
        self.accuracy = accuracy
        self.n = len(geometry.electrode_deg)
        self.on_rim = Electrodes(geometry.rim_part, disc, order) if geometry.has_rim else None
        self.inner = InnerElectrodes(geometry, disc, accuracy, inner_orders)
        self.rim = self.on_rim.rim if self.on_rim else np.zeros(0, complex)
        self.nodes = np.concatenate([self.rim, self.inner.nodes])
        rim_size = self.on_rim.size if self.on_rim else 0
        self.size = rim_size + self.inner.size
        self.whole = np.zeros(self.n, int)
        if self.on_rim:
            self.whole[geometry.on_rim] = self.on_rim.whole
        inner_whole = len(self.inner.modes) * np.arange(self.inner.count)
        self.whole[self.inner.numbers] = rim_size + inner_whole

    @cached_property
    def interaction(self) -> np.ndarray:
        """(size, size): `matrix` without the contacts' drop, and without what an electrode inside
        takes by itself."""
        inner = self.inner.interaction
        if not self.on_rim:
            return inner
        kernel = neumann.potential(self.rim[:, None], self.inner.nodes)
        across = self.on_rim.project(self.inner.project(kernel.T).T)
        return np.block([[self.on_rim.interaction, across], [across.T, inner]])

    @cached_property
    def matrix(self) -> np.ndarray:
        """(size, size): power of the modes' currents."""
        matrix = self.interaction.copy()
        rim_size = self.size - self.inner.size
        if self.on_rim:
            matrix[:rim_size, :rim_size] = self.on_rim.matrix
        index = np.arange(rim_size, self.size)
        matrix[index, index] += self.inner.self_power(self.geometry)
        return matrix

    def with_contacts(self, geometry: Geometry) -> "RimAndInnerElectrodes":
        """The same electrodes on a geometry of the same outline, with other contacts or
        material."""
        electrodes = copy.copy(self)
        electrodes.geometry = geometry
        if self.on_rim:
            electrodes.on_rim = self.on_rim.with_contacts(geometry.rim_part)
        electrodes.__dict__.pop("matrix", None)
        return electrodes

    def on(self, geometry: Geometry) -> "RimAndInnerElectrodes":
        """The electrodes of a slightly different geometry with the same rim, by the same modes."""
        shared = self.disc, self.order, self.accuracy, self.inner.orders
        return RimAndInnerElectrodes(geometry, *shared)

    def project(self, potential: np.ndarray) -> np.ndarray:
        """(..., size, k): projection on the modes of potentials at the nodes (..., nodes, k)."""
        rim_nodes = len(self.rim)
        inner = self.inner.project(potential[..., rim_nodes:, :])
        if not self.on_rim:
            return inner
        return np.concatenate([self.on_rim.project(potential[..., :rim_nodes, :]), inner], axis=-2)

    def flux_kernel(self, y: np.ndarray, dy: np.ndarray) -> np.ndarray:
        """(nodes, N): `neumann.flux_kernel` from a curve's nodes y (N,) to the electrodes'."""
        on_rim = neumann.rim_flux_kernel(self.rim, y, dy)
        return np.concatenate([on_rim, neumann.flux_kernel(self.inner.nodes[:, None], y, dy)])

    def coupling(self, touch: Any) -> np.ndarray:
        """(..., size, 2 degree): projection on the modes of the potential that a touch's
        polarisation makes; of a TouchEdge or EvenTouches."""
        potential = touch.response_within(self.inner.nodes)
        if isinstance(touch, TouchEdge):
            centre, radius = np.array([touch.centre]), np.array([touch.radius])
            is_covered = np.repeat(self.inner.covered(centre, radius), self.inner.place.shape[1])
            potential[is_covered] += touch.harmonics.values(self.inner.nodes[is_covered])
        inner = self.inner.project(potential)
        if not self.on_rim:
            return inner
        return np.concatenate([self.on_rim.project(touch.rim_response(self.rim)), inner], axis=-2)

    def covers(self, places: Sequence[Place]) -> np.ndarray:
        """(P,) bool: whether touches at places (x_mm, y_mm, radius_mm) have electrodes within."""
        x, y, radius = np.array(places, float).reshape(-1, 3).T
        return np.asarray(self.inner.covered(x + 1j * y, radius).any(axis=1))

    def covered(self, place: Place) -> CoveredElectrodes:
        """What a touch at a place does within itself to the currents of the electrodes that it
        covers; coupling (size, K). Raises InputError for one that the rim cuts."""
        x, y, radius = place
        centre = np.array([x + 1j * y])
        is_covered = self.inner.covered(centre, np.array([radius]))[0]
        if not distance(self.geometry.rim_polygon, centre)[0] > radius:
            number = self.inner.numbers[is_covered][0]
            actual = f"({x:g}, {y:g}) mm, cut by the rim, over electrode {number}"
            raise InputError("touch", "place", actual, "one that the rim does not cut")
        layer_mm = self.inner.layer_mm(self.geometry)
        inner = covered_electrodes(self.inner, layer_mm, is_covered, complex(centre[0]), radius)
        coupling = np.zeros((self.size, len(inner.response)))
        coupling[self.size - self.inner.size :] = inner.coupling
        return CoveredElectrodes(inner.response, coupling)

    def clearance(self, circles: Circle) -> np.ndarray:
        """(P,): distances of circles, centre and radius (P, 1), from the electrodes inside, in
        their radii, also of those that they cover. Raises InputError for a circle that crosses the
        edge of one."""
        centre, radius = circles.centre[:, 0], circles.radius[:, 0]
        gaps = self.inner.gaps(centre, radius)
        for circle, electrode in np.argwhere(gaps <= 0.0)[:1].tolist():
            place = f"({centre[circle].real:g}, {centre[circle].imag:g}) mm"
            number = self.inner.numbers[electrode]
            actual = f"{place}, radius {radius[circle]:g} mm, across electrode {number}"
            raise InputError("touch", "place", actual, "a disc beside it, or that covers it")
        return gaps.min(axis=1) / radius
