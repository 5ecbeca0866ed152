"""A skin with patches: discs of other conductivities, and touches that may lie across one's edge.

Where a patch and a touch overlap, their factors multiply. Then a circle of conductivity reflects
the field alike on its whole length, whatever the other circle does: the bound charge tau on it
obeys tau = -2 q du/dn, q = (factor - 1) / (factor + 1), with u's mean normal derivative (as in
Greengard, Moura 1994 for circles that stay apart). The patch is kept as this charge, on even nodes
and, where a touch comes near, on nodes graded towards it; the touch is kept as its polarisation,
in multipoles of the patched skin: fields that bend at the patch's edge as the current does.
Several patches stay apart, and induce charge on one another; no touch is solved beside them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.conformal import DiscMap
from eitskin.physics.contact_current import EvenCurrent
from eitskin.physics.electrodes import Electrodes
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.touch import (
    EDGE_ANGLES,
    NODE_COUNTS,
    Circle,
    PanelSizes,
    Surroundings,
    Touch,
    TouchAccuracy,
    TouchEdge,
    even_nodes,
)
from eitskin.physics.touch_cache import ContactCoupling, Place, TouchCache, TouchCoupling

# Of a patch to the rim or another patch, in its radii: closer, it needs more nodes than there are.
LEAST_GAP = 0.03
LEAST_NODES = 48  # resolve a patch far from the rim
LONGEST_PANEL = 0.6  # radians
PATCHED_EFFORT = 3.0  # of a new touched place, relative to one on a skin without a patch
SAME_CIRCLE = 0.01  # of the patch's radius; a touch this close to the patch is its disc, to 2 %


class PatchEdge(Circle):
    """A patch's edge on even nodes, and the charge that an external field induces on it.

    Charges are per node, quadrature weights included. Raises InputError for a patch that the rim
    or another one clips or nearly touches.
    """

    def __init__(self, patch: Patch, geometry: Geometry, disc: DiscMap, accuracy: TouchAccuracy):
        super().__init__(patch.centre, patch.radius_mm, geometry, disc)
        self.factor, self.accuracy = patch.contrast, accuracy
        self.reflection = 2.0 * (self.factor - 1.0) / (self.factor + 1.0)
        self.digits = -np.log(accuracy.tolerance)
        gap = self.rim_gap()
        on_skin = np.abs(self.place(EDGE_ANGLES)).max() < np.abs(geometry.rim(EDGE_ANGLES)).max()
        if not (on_skin and gap > LEAST_GAP):
            place = f"({patch.x_mm:g}, {patch.y_mm:g}) mm, radius {patch.radius_mm:g} mm"
            expected = f"a disc within the skin, off its rim by {LEAST_GAP:g} of its radius"
            raise InputError("skin", "patch", place, expected)
        others = [p for p in geometry.patches if p is not patch]
        gaps = [abs(p.centre - patch.centre) - p.radius_mm - patch.radius_mm for p in others]
        electrode_gaps = np.abs(geometry.inner_place - patch.centre) - patch.radius_mm
        electrode_gaps -= 0.5 * geometry.electrode_width_mm[geometry.inner]
        if (electrode_gaps < LEAST_GAP * patch.radius_mm).any():
            number = geometry.inner[electrode_gaps.argmin()]
            place = f"({patch.x_mm:g}, {patch.y_mm:g}) mm, over electrode {number}"
            expected = f"a disc off the electrodes inside the skin by {LEAST_GAP:g} of its radius"
            raise InputError("skin", "patch", place, expected)
        gaps += electrode_gaps.tolist()
        gap_to_others = min(gaps, default=np.inf) / patch.radius_mm
        if gap_to_others < LEAST_GAP:
            expected = f"discs apart by {LEAST_GAP:g} of a radius"
            raise InputError("skin", "patches", "two that overlap", expected)
        minimum_node_count = max(self.digits / np.log1p(min(gap, gap_to_others)), LEAST_NODES)
        count = next((n for n in NODE_COUNTS if n >= minimum_node_count), NODE_COUNTS[-1])
        self.t, self.weight = even_nodes(count)
        self.zeta, self.tangent, curvature = self.mapped(self.t, 2)
        self.dzeta = self.tangent * self.weight
        kernel = neumann.self_flux_kernel(self.zeta, self.tangent, curvature, self.weight)
        self.kernel = kernel.T

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        return lu_factor(np.eye(len(self.t)) + self.reflection * self.kernel)

    def charge(self, flux: np.ndarray) -> np.ndarray:
        """(nodes, k): charge on the edge induced by fields with this flux (nodes, k) through it."""
        return lu_solve(self._factors, -self.reflection * flux)

    def nodes_beside(self, circle: Circle) -> "PatchNodes":
        """Nodes that resolve the field of another circle close to this one; the even ones where
        it is far."""
        gap = self.gap(circle) / self.radius
        if gap > 0 and self.digits / np.log1p(gap) <= len(self.t):
            return PatchNodes(self, self.t, self.zeta, self.dzeta, None)
        start = np.angle(circle.centre - self.centre)
        panels = PanelSizes(LONGEST_PANEL, self.accuracy.rim_gap, self.accuracy.panel_nodes)
        stop = start + 2.0 * np.pi
        t, weight = self.panels(start, stop, circle, lambda t: np.inf, panels)
        zeta, tangent = self.mapped(t, 1)
        half_angle = 0.5 * (t[:, None] - self.t)
        count = len(self.t)
        with np.errstate(divide="ignore", invalid="ignore"):
            dirichlet = np.sin(count * half_angle) / (count * np.tan(half_angle))
        spread = np.where(np.abs(np.sin(half_angle)) < 1e-14, 1.0, dirichlet)
        return PatchNodes(self, t, zeta, tangent * weight, spread, weight)


class PatchEdges:
    """The edges of all patches of a skin on their even nodes, one after the other.

    zeta, dzeta (nodes,): as of an edge. Raises InputError as PatchEdge does.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap, accuracy: TouchAccuracy):
        self.edges = [PatchEdge(patch, geometry, disc, accuracy) for patch in geometry.patches]
        self.zeta = np.concatenate([edge.zeta for edge in self.edges])
        self.dzeta = np.concatenate([edge.dzeta for edge in self.edges])
        self.reflection = np.repeat(
            [edge.reflection for edge in self.edges], [len(edge.t) for edge in self.edges]
        )

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        kernel = np.block(
            [[self._kernel(source, target) for source in self.edges] for target in self.edges]
        )
        return lu_factor(np.eye(len(self.zeta)) + self.reflection[:, None] * kernel)

    @staticmethod
    def _kernel(source: PatchEdge, target: PatchEdge) -> np.ndarray:
        """(target's nodes, source's nodes): flux through one edge of charges on another."""
        if source is target:
            return source.kernel
        return neumann.flux_kernel(source.zeta[:, None], target.zeta, target.dzeta).T

    def charge(self, flux: np.ndarray) -> np.ndarray:
        """(nodes, k): charge on the edges induced by fields with this flux (nodes, k) through
        them."""
        return lu_solve(self._factors, -self.reflection[:, None] * flux)


@dataclass(frozen=True)
class PatchNodes:
    """Nodes of a patch's edge for one touch. spread (nodes, even nodes): trigonometric
    interpolation from the even nodes; None where the nodes are the even ones."""

    edge: PatchEdge
    t: np.ndarray
    zeta: np.ndarray
    dzeta: np.ndarray
    spread: np.ndarray | None
    weight: np.ndarray | None = None

    def even(self, charge: np.ndarray) -> np.ndarray:
        """(even nodes, k): charges on the even nodes with the same action on any smooth function
        of the edge."""
        return charge if self.spread is None else self.spread.T @ charge

    def charge(self, flux: np.ndarray) -> np.ndarray:
        """(nodes, k): charge on the edge induced by fields with this flux (nodes, k) through it."""
        even = self.edge.charge(self.even(flux))
        if self.spread is None:
            return even
        return -self.edge.reflection * (flux + self._self_flux(even))

    def _self_flux(self, even: np.ndarray) -> np.ndarray:
        assert self.spread is not None and self.weight is not None
        per_angle = (self.edge.kernel @ even) / self.edge.weight[:, None]
        return self.weight[:, None] * (self.spread @ per_angle)

    def charge_within(self, flux: np.ndarray, within: np.ndarray) -> np.ndarray:
        """(nodes, k): induced charge on the nodes of the mask `within` alone, where it balances
        the flux."""
        charge = np.zeros_like(flux)
        if within.all():
            return self.charge(flux)
        assert self.spread is not None and self.weight is not None  # even ones are all within
        part_spread = self.spread[within]
        kernel = self.edge.kernel / self.edge.weight[:, None]
        self_flux = self.weight[within, None] * (part_spread @ kernel @ part_spread.T)
        system = np.eye(len(part_spread)) + self.edge.reflection * self_flux
        charge[within] = np.linalg.solve(system, -self.edge.reflection * flux[within])
        return charge


@dataclass(frozen=True)
class BareTouch:
    """A touch on the skin without its patch: its edge, with the nodes that it has beside the
    patch, and its multipoles' coupling (n order, 2 degree) to the electrodes' modes before those
    relax."""

    edge: TouchEdge
    coupling: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        arrays = [v for v in vars(self.edge).values() if isinstance(v, np.ndarray)]
        return self.coupling.nbytes + sum(array.nbytes for array in arrays)


@dataclass(frozen=True)
class PatchedTouch:
    """A touch on a patched skin, with the interface of a TouchEdge and its coupling.

    mass, self_response (2 degree, 2 degree): of the multipoles of the patched skin; coupling (n
    order, 2 degree): to the electrodes' modes before those relax; factor: of the skin's
    conductivity within the touch, None where the patch's edge crosses it; nodes: of the patch's
    edge; charge (nodes, 2 degree): induced on them by the multipoles.
    """

    touch: Touch
    edge: TouchEdge
    mass: np.ndarray
    self_response: np.ndarray
    coupling: np.ndarray
    factor: float | None
    nodes: PatchNodes | None = None
    charge: np.ndarray | None = None

    @classmethod
    def covering_patch(
        cls, touch: Touch, patch: PatchEdge, forward: "PatchForward"
    ) -> "PatchedTouch":
        """A touch that covers exactly the patch: both factors apply to one disc."""
        edge = TouchEdge(touch, patch.geometry, patch.disc, forward.accuracy.touch)
        factor, self_response = patch.factor, edge.self_response
        patched = factor * np.linalg.solve(edge.mass + (factor - 1.0) * self_response, edge.mass)
        coupling = forward.electrodes.coupling(edge) @ patched
        response = factor * self_response @ patched
        return cls(touch, edge, factor * edge.mass, 0.5 * (response + response.T), coupling, None)

    @classmethod
    def beside_patch(
        cls, touch: Touch, patch: PatchEdge, forward: "PatchForward"
    ) -> "PatchedTouch":
        """A touch beside the patch, within it, around it or across its edge."""
        bare = forward.bare_touch(touch)
        edge, nodes = bare.edge, patch.nodes_beside(bare.edge)
        within = np.abs(patch.place(nodes.t) - edge.centre) < edge.radius
        inside = np.abs(edge.place(edge.t) - patch.centre) < patch.radius
        if not len(edge.crossings(patch)):
            within[:], inside[:] = within.mean() > 0.5, inside.mean() > 0.5
            if not within.any():
                factor = patch.factor if inside.any() else 1.0
                return cls._uncrossed(touch, bare, nodes, factor, forward)
        rim = np.exp(1j * edge.rim_theta)
        boundary = np.concatenate([edge.zeta, rim])
        dzeta = np.concatenate([edge.tangent * edge.weight, 1j * rim * edge.rim_weight])
        values, flux = edge.harmonics.values(boundary), edge.harmonics.flux(boundary, dzeta)
        to_touch = neumann.potential(boundary[:, None], nodes.zeta)
        bend = np.zeros((len(nodes.t), values.shape[1]))
        if within.any():
            bend = nodes.charge_within(edge.harmonics.flux(nodes.zeta, nodes.dzeta), within)
            values = values + to_touch @ bend
            flux = flux + neumann.flux_kernel(nodes.zeta[:, None], boundary, dzeta).T @ bend
        into_patch = neumann.flux_kernel(boundary[:, None], nodes.zeta, nodes.dzeta)
        charge = nodes.charge(into_patch.T @ flux) - bend
        current, on_edge = flux.copy(), len(edge.zeta)
        current[:on_edge][inside] *= patch.factor
        mass = current.T @ values
        response = current[:on_edge].T @ (edge.kernel @ values[:on_edge])
        response += current[on_edge:].T @ (edge.rim_kernel @ values[:on_edge])
        response += mass + current.T @ (to_touch @ charge)
        electrodes = forward.electrodes
        kernel = electrodes.flux_kernel(edge.zeta, dzeta[:on_edge])
        potential = kernel @ values[:on_edge]
        if edge.clipped:
            covered = np.flatnonzero(edge.covers(electrodes.rim))
            covered_rim = electrodes.rim[covered]
            potential[covered] += edge.harmonics.values(covered_rim)
            potential[covered] += neumann.potential(covered_rim[:, None], nodes.zeta) @ bend
        return cls(
            touch,
            edge,
            0.5 * (mass + mass.T),
            0.5 * (response + response.T),
            electrodes.project(potential) + forward.at_patch.T @ nodes.even(charge),
            None if within.any() else patch.factor if inside.any() else 1.0,
            nodes,
            charge,
        )

    @classmethod
    def _uncrossed(
        cls,
        touch: Touch,
        bare: BareTouch,
        nodes: PatchNodes,
        factor: float,
        forward: "PatchForward",
    ) -> "PatchedTouch":
        """A touch that the patch's edge does not cross, where the skin's factor is `factor`: its
        response on the bare skin plus that of the patch's induced charge."""
        edge = bare.edge
        rim = np.exp(1j * edge.rim_theta)
        boundary = np.concatenate([edge.zeta, rim])
        flux = np.concatenate([edge.flux, edge.rim_flux])
        into_patch = neumann.flux_kernel(boundary[:, None], nodes.zeta, nodes.dzeta)
        charge = nodes.charge(into_patch.T @ flux)
        patch_response = flux.T @ (neumann.potential(boundary[:, None], nodes.zeta) @ charge)
        response = factor * (edge.self_response + 0.5 * (patch_response + patch_response.T))
        coupling = bare.coupling + forward.at_patch.T @ nodes.even(charge)
        mass = factor * edge.mass
        return cls(touch, edge, mass, response, coupling, factor, nodes, charge)


class PatchForward(Forward):
    """A skin with patches, of which one alone may be touched, at one place; otherwise like Forward.

    Raises InputError for a patch at the rim, for two that overlap, and for one on a skin whose
    conductivity rises across it. In a body, a patch reaches through the whole depth; it and touches
    beside it couple to the mean over the depth alone.
    """

    touch_effort = PATCHED_EFFORT * Forward.touch_effort
    patches: PatchEdges
    at_patch: np.ndarray
    change: np.ndarray

    def __init__(self, bare: Forward, geometry: Geometry, donor: Forward | None = None):
        """`bare`: the same skin without patches; `donor`: a solved skin, to share parts with."""
        vars(self).update(vars(bare))
        self.bare, self.geometry = bare, geometry
        self.effort, self.touch_effort = bare.effort, PATCHED_EFFORT * bare.touch_effort
        if bare.bulk:
            raise InputError("skin", "patch", "a gradient of the conductivity", "none")
        if (
            isinstance(donor, PatchForward)
            and donor.geometry.patches == geometry.patches
            and donor.bare.matches(bare.geometry, bare.accuracy, bare.electrodes.order)
        ):
            self.patches, self.at_patch = donor.patches, donor.at_patch
            self._touch_cache = donor._touch_cache
            change = donor.change
        else:
            self.patches = PatchEdges(geometry, bare.disc, bare.accuracy.touch)
            self._touch_cache = TouchCache()
            self.at_patch = self._at_patch(bare.electrodes)
            change = self._change(bare.electrodes)
        self.change = change
        vars(self).pop("relaxed_modes", None)  # of the bare skin
        self.unit_currents()

    @property
    def power_matrix(self) -> np.ndarray:
        """As for Forward, with what the patches change."""
        return super().power_matrix + self.change

    @property
    def patch(self) -> PatchEdge:
        """The edge of the one patch. Raises InputError where there are several."""
        if len(self.patches.edges) > 1:
            raise InputError("touch", "touches", "one on a skin with several patches", "none")
        return self.patches.edges[0]

    @property
    def nbytes(self) -> int:
        """Bytes of the modes' matrices with and without patches."""
        return super().nbytes + self.bare.nbytes + self.change.nbytes

    def bare_touch(self, touch: Touch) -> BareTouch:
        """The touch on the skin without the patch. It is cached with the bare skin where its
        nodes are even: graded nodes suit this patch alone."""
        geometry, accuracy = self.geometry, self.accuracy.touch

        def compute() -> BareTouch:
            surroundings = Surroundings(self.clearance(touch), self.patch)
            edge = TouchEdge(touch, geometry, self.patch.disc, accuracy, surroundings)
            coupling = self.electrodes.coupling(edge)
            return BareTouch(edge, coupling)

        def serves(touch: BareTouch) -> bool:
            return touch.edge.serves_beside(self.patch)

        place = touch.x_mm, touch.y_mm, touch.radius_mm
        return self.bare._touch_cache.get(BareTouch, place, compute, serves)

    def _new_couplings(self, places: list[Place]) -> dict[Place, TouchCoupling]:
        """Empty: bare touches are cached and computed one by one."""
        return {}

    def _at_patch(self, electrodes: Electrodes) -> np.ndarray:
        """(even nodes, n order): potentials of the electrodes' modes on the patches' edges."""
        return electrodes.project(neumann.potential(electrodes.nodes[:, None], self.patches.zeta)).T

    def _change(self, electrodes: Electrodes) -> np.ndarray:
        """(n order, n order): change of the power of the electrodes' modes by the patches."""
        flux = electrodes.flux_kernel(self.patches.zeta, self.patches.dzeta)
        modes = np.flatnonzero(self.at_patch.any(axis=0))  # of a body, those even over the depth
        charge = self.patches.charge(electrodes.project(flux).T[:, modes])
        change = np.zeros((self.at_patch.shape[1],) * 2)
        even_change = self.at_patch[:, modes].T @ charge
        change[np.ix_(modes, modes)] = 0.5 * (even_change + even_change.T)
        return change

    def edge(  # type: ignore[override]  # what it makes of touches only it meets again
        self, touch: Touch, touch_clearance: float = np.inf
    ) -> PatchedTouch:
        """The touch's multipoles in the patched skin. Raises InputError for several touches."""
        if np.isfinite(touch_clearance):
            raise InputError("touch", "touches", "several on a patched skin", "one")
        if self.electrodes.covers([(touch.x_mm, touch.y_mm, touch.radius_mm)])[0]:
            place = f"({touch.x_mm:g}, {touch.y_mm:g}) mm, over an electrode inside the skin"
            raise InputError("touch", "place", place, "one beside it, on a patched skin")
        offset = abs(touch.x_mm + 1j * touch.y_mm - self.patch.centre)
        if offset + abs(touch.radius_mm - self.patch.radius) < SAME_CIRCLE * self.patch.radius:
            return PatchedTouch.covering_patch(touch, self.patch, self)
        return PatchedTouch.beside_patch(touch, self.patch, self)

    def _to_electrodes(self, edge: PatchedTouch) -> np.ndarray:  # type: ignore[override]
        return edge.coupling

    def _even_current(self, edge: PatchedTouch) -> ContactCoupling:  # type: ignore[override]
        """The coupling, as for Forward. Raises InputError for a touch that covers a part of the
        patch's edge."""
        if edge.factor is None:
            place = f"({edge.touch.x_mm:g}, {edge.touch.y_mm:g}) mm, across a patch's edge"
            raise InputError("touch", "leak at the touch", place, "a touch on either side of it")
        assert edge.nodes is not None
        current, nodes, electrodes = EvenCurrent(edge.edge), edge.nodes, self.electrodes
        charge = nodes.charge(current.flux(nodes.zeta, nodes.dzeta)[:, None] / edge.factor)
        at_nodes = current.potential(nodes.zeta)
        potential = current.potential(electrodes.nodes)[:, None]
        direct = electrodes.project(potential) / edge.factor
        to_electrodes = direct + self.at_patch.T @ nodes.even(charge)
        to_touch = current.mean_response(edge.edge) + at_nodes @ edge.charge
        power = current.power / edge.factor + float(at_nodes @ charge[:, 0])
        inner_power = current.inner_power / edge.factor
        return ContactCoupling(to_electrodes[:, 0], to_touch, power, inner_power)

    def derivatives(
        self, touches: Sequence[Touch] = (), parameters: list[str] | None = None
    ) -> NoReturn:
        """Raises InputError: derivatives of a patched skin are not implemented."""
        raise InputError("skin", "patch", "one", "none, to differentiate")
