"""Electrodes inside a skin: discs through whose area the current enters, or points.

On a disc of radius rho the current density j obeys Delta j = j / lambda^2, lambda^2 = sigma h z, so
its modes are I_m(r / lambda) cos m theta and sin m theta, one an angular order. Beyond the disc a
mode acts as a ring of charge on its edge with the same moment int j (r / rho)^m cos m theta dA, and
what the rest of the skin does to it is harmonic within: the Fourier coefficient on the edge is all
that it feels. A disc and the drop of its contact take the power A_m of a unit moment, in closed
form: A_0 = -ln rho / 2 pi + I_0 / (2 pi x I_1) and A_m = 1 / (2 pi m) + I_m / (pi x I_m+1) of
x = rho / lambda.
"""

from functools import cached_property

import numpy as np

from eitskin.physics import neumann
from eitskin.physics.bessel_ratios import inner_steps
from eitskin.physics.conformal import DiscMap
from eitskin.physics.geometry import Geometry
from eitskin.physics.rim_curve import distance
from eitskin.physics.touch import TouchAccuracy

NEAREST = 1.0  # radii from an electrode, within which it resolves no touch fully
MOST_ORDERS = 48
NODES_PER_ORDER = 3  # of an electrode's edge, against aliasing of what bends at it


class InnerElectrodes:
    """Nodes and modes of the electrodes inside a skin, `count` of them, at `numbers` of all.

    Modes are by electrode: the whole current, then cosines and sines of every angular order, of
    unit moment. nodes (count K,): on the electrodes' edges, in the unit disc; modes (size /
    count, K). Matrices are per unit sheet resistance.
    """

    def __init__(
        self,
        geometry: Geometry,
        disc: DiscMap,
        accuracy: TouchAccuracy,
        orders: int | None = None,
    ):
        """`orders`: angular ones, by default as many as the accuracy needs."""
        self.geometry, self.disc = geometry, disc
        self.numbers = geometry.inner
        self.centre = geometry.inner_place
        self.radius = 0.5 * geometry.electrode_width_mm[self.numbers]
        self.count = len(self.numbers)
        if orders is None:
            orders = 0 if geometry.points else self._needed_orders(accuracy)
        self.orders = orders
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
        steps = inner_steps(self.orders, self.radius / self.layer_mm(geometry)).T
        power[:, 0] = (1.0 / steps[:, 0] - np.log(self.radius)) / (2.0 * np.pi)
        order = np.arange(1, self.orders + 1)
        power[:, 1:] = np.tile((0.5 / order + 1.0 / steps[:, 1:]) / np.pi, 2)
        return power.ravel()

    def project(self, potential: np.ndarray) -> np.ndarray:
        """(..., size, k): projection on the modes of potentials at the nodes (..., count K, k)."""
        *stack, _, k = potential.shape
        per = potential.reshape(*stack, *self.place.shape, k)
        return (self.modes @ per).reshape(*stack, self.size, k)

    def layer_mm(self, geometry: Geometry) -> np.ndarray:
        """(count,): lambda of every electrode, with the contacts and the material of a geometry."""
        return np.sqrt(geometry.contact_length_mm[self.numbers] * geometry.thickness_mm)

    def covered(self, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(P, count) bool: whether circles (P,), in mm, have the electrodes within."""
        return np.abs(centre[:, None] - self.centre) + self.radius < radius[:, None]

    def gaps(self, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(P, count): distances in mm of circles (P,) from the electrodes' edges; below 0 where
        they cross."""
        return np.abs(np.abs(centre[:, None] - self.centre) - radius[:, None]) - self.radius
