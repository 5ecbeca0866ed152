"""Electrodes inside a skin: discs through whose area the current enters, or points.

On a disc of radius rho the current density j obeys Delta j = j / lambda^2, lambda^2 = sigma h z, so
its modes are I_m(r / lambda) cos m theta and sin m theta, one an angular order. Beyond the disc a
mode acts as a ring of charge on its edge with the same moment int j (r / rho)^m cos m theta dA, and
what the rest of the skin does to it is harmonic within: the Fourier coefficient on the edge is all
that it feels. A disc and the drop of its contact take the power A_m of a unit moment, in closed
form: A_0 = -ln rho / 2 pi + I_0 / (2 pi x I_1) and A_m = 1 / (2 pi m) + I_m / (pi x I_m+1) of
x = rho / lambda.
"""

import copy
from functools import cached_property
from typing import Any

import numpy as np

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.bessel_ratios import inner_steps
from eitskin.physics.conformal import DiscMap
from eitskin.physics.electrodes import Electrodes
from eitskin.physics.geometry import Geometry
from eitskin.physics.rim_curve import distance
from eitskin.physics.touch import Circle, TouchAccuracy

NEAREST = 1.0  # radii from an electrode, within which it resolves no touch fully
MOST_ORDERS = 48
NODES_PER_ORDER = 3  # of an electrode's edge, against aliasing of what bends at it


class InnerElectrodes:
    """Nodes and modes of the electrodes inside a skin, `count` of them, at `numbers` of all.

    Modes are by electrode: the whole current, then cosines and sines of every angular order, of
    unit moment. nodes (count K,): on the electrodes' edges, in the unit disc; modes (size /
    count, K). Matrices are per unit sheet resistance.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap, accuracy: TouchAccuracy):
        self.geometry, self.disc = geometry, disc
        self.numbers = geometry.inner
        self.centre = geometry.inner_place
        self.radius = 0.5 * geometry.electrode_width_mm[self.numbers]
        self.count = len(self.numbers)
        self.orders = 0 if geometry.points else self._needed_orders(accuracy)
        nodes = NODES_PER_ORDER * self.orders + 1
        theta = 2.0 * np.pi * np.arange(nodes) / nodes
        angle = np.arange(1, self.orders + 1)[:, None] * theta
        waves = 2.0 * np.concatenate([np.cos(angle), np.sin(angle)])
        self.modes = np.concatenate([np.ones((1, nodes)), waves]) / nodes
        self.place = self.centre[:, None] + self.radius[:, None] * np.exp(1j * theta)
        self.size = self.count * len(self.modes)
        mapped, self._slope = disc.derivatives(self.place, 1)
        self.nodes = mapped.ravel()

    def _needed_orders(self, accuracy: TouchAccuracy) -> int:
        """Angular orders that resolve the gaps between electrodes, and to their images beyond the
        rim."""
        to_rim = 2.0 * (distance(self.geometry.rim_polygon, self.centre) - self.radius)
        apart = np.abs(self.centre[:, None] - self.centre) - self.radius
        np.fill_diagonal(apart, np.inf)
        gap = np.minimum(to_rim, (apart - self.radius[:, None]).min(axis=1)) / self.radius
        needed = np.ceil(0.5 * accuracy.across(min(float(gap.min()), NEAREST)))
        return int(min(needed, MOST_ORDERS))

    @cached_property
    def interaction(self) -> np.ndarray:
        """(size, size): power of the modes, without that of an electrode alone."""
        count, nodes = self.place.shape
        same_electrode = np.kron(np.eye(count, dtype=bool), np.ones((nodes, nodes), dtype=bool))
        same_node = np.eye(count * nodes, dtype=bool)
        kernel = neumann.potential(self.nodes[:, None] + 2.0 * same_node, self.nodes)
        place = self.place.ravel()
        apart = np.abs(place[:, None] - place) + same_node
        kernel[same_electrode] += np.log(apart[same_electrode]) / (2.0 * np.pi)
        image = np.log(np.abs(self._slope.ravel())) + np.log(1.0 - np.abs(self.nodes) ** 2)
        kernel[same_node] = -image / (2.0 * np.pi)
        return self.project(self.project(kernel).T)

    def self_power(self, geometry: Geometry) -> np.ndarray:
        """(size,): power of every mode by itself in an endless sheet, with the contact's drop; NaN
        of points, and for lengths in mm."""
        power = np.full((self.count, len(self.modes)), np.nan)
        if geometry.points:
            return power.ravel()
        length2 = geometry.contact_length_mm[self.numbers] * geometry.thickness_mm
        steps = inner_steps(self.orders, self.radius / np.sqrt(length2)).T
        power[:, 0] = (1.0 / steps[:, 0] - np.log(self.radius)) / (2.0 * np.pi)
        order = np.arange(1, self.orders + 1)
        power[:, 1:] = np.tile((0.5 / order + 1.0 / steps[:, 1:]) / np.pi, 2)
        return power.ravel()

    def project(self, potential: np.ndarray) -> np.ndarray:
        """(..., size, k): projection on the modes of potentials at the nodes (..., count K, k)."""
        *stack, _, k = potential.shape
        per = potential.reshape(*stack, *self.place.shape, k)
        return (self.modes @ per).reshape(*stack, self.size, k)

    def gaps(self, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(P, count): distances in mm of circles (P,) from the electrodes' edges; negative where
        they overlap, by how much."""
        return np.abs(centre[:, None] - self.centre) - radius[:, None] - self.radius


class RimAndInnerElectrodes:
    """All electrodes of a skin with some, or all, of them inside, with the interface of Electrodes.

    Nodes and modes are those on the rim, then those inside; whole (n,): the modes of the
    electrodes' whole currents.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap, order: int, accuracy: TouchAccuracy):
        self.geometry, self.disc, self.order = geometry, disc, order
        self.accuracy = accuracy
        self.n = len(geometry.electrode_deg)
        self.on_rim = Electrodes(geometry.rim_part, disc, order) if geometry.has_rim else None
        self.inner = InnerElectrodes(geometry, disc, accuracy)
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
        return RimAndInnerElectrodes(geometry, self.disc, self.order, self.accuracy)

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
        inner = self.inner.project(touch.response_within(self.inner.nodes))
        if not self.on_rim:
            return inner
        return np.concatenate([self.on_rim.project(touch.rim_response(self.rim)), inner], axis=-2)

    def clearance(self, circles: Circle) -> np.ndarray:
        """(P,): distances of circles, centre and radius (P, 1), from the electrodes inside, in
        their radii. Raises InputError for a circle that meets one."""
        centre, radius = circles.centre[:, 0], circles.radius[:, 0]
        gaps = self.inner.gaps(centre, radius)
        for circle, electrode in np.argwhere(gaps <= 0.0)[:1].tolist():
            place = f"({centre[circle].real:g}, {centre[circle].imag:g}) mm"
            number = self.inner.numbers[electrode]
            actual = f"{place}, radius {radius[circle]:g} mm, over electrode {number}"
            raise InputError("touch", "place", actual, "a disc off the electrodes inside the skin")
        return gaps.min(axis=1) / radius
