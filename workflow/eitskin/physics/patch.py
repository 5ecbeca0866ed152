"""A skin with a patch: a disc of another conductivity, and touches that may lie across its edge.

Where a patch and a touch overlap, their factors multiply. Then a circle of conductivity reflects
the field alike on its whole length, whatever the other circle does: the bound charge tau on it
obeys tau = -2 q du/dn, q = (factor - 1) / (factor + 1), with u's mean normal derivative (as in
Greengard, Moura 1994 for circles that stay apart). The patch is kept as this charge, on even nodes
and, where a touch comes near, on nodes graded towards it; the touch is kept as its polarisation,
in multipoles of the patched skin: fields that bend at the patch's edge as the current does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.conformal import DiscMap
from eitskin.physics.contact_current import EvenCurrent
from eitskin.physics.electrodes import Electrodes
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.kept_touches import Coupled, Entered, KeptTouches, Place
from eitskin.physics.touch import (
    NODE_COUNTS,
    ROUND,
    Circle,
    Touch,
    TouchAccuracy,
    TouchEdge,
    even_nodes,
)

LEAST_GAP = 0.03  # of a patch to the rim, in its radii
LEAST_NODES = 48
LONGEST_PANEL = 0.6
PATCHED = 3.0  # times what a new touched place takes on a skin without a patch
SAME_CIRCLE = 0.01  # a touch closer to the patch's own disc, in its radii, is taken for it: to 2 %


class PatchEdge(Circle):
    """A patch's edge on even nodes, and the charge that any field leaves on it.

    Charges are per node, their weights included. Raises InputError for a patch that the rim clips
    or nearly touches.
    """

    def __init__(self, geometry: Geometry, disc: DiscMap, accuracy: TouchAccuracy):
        patch = geometry.patch
        assert patch is not None
        super().__init__(patch.centre, patch.radius_mm, geometry, disc)
        self.factor, self.accuracy = patch.contrast, accuracy
        self.reflection = 2.0 * (self.factor - 1.0) / (self.factor + 1.0)
        self.digits = -np.log(accuracy.tolerance)
        gap = self.rim_gap()
        on_skin = np.abs(self.place(ROUND)).max() < np.abs(geometry.rim(ROUND)).max()
        if not (on_skin and gap > LEAST_GAP):
            place = f"({patch.x_mm:g}, {patch.y_mm:g}) mm, radius {patch.radius_mm:g} mm"
            expected = f"a disc within the skin, off its rim by {LEAST_GAP:g} of its radius"
            raise InputError("skin", "patch", place, expected)
        wanted = max(self.digits / np.log1p(gap), LEAST_NODES)
        count = next((n for n in NODE_COUNTS if n >= wanted), NODE_COUNTS[-1])
        self.t, self.weight = even_nodes(count)
        self.zeta, self.tangent, curvature = self.mapped(self.t, 2)
        self.dzeta = self.tangent * self.weight
        kernel = neumann.own_flux_kernel(self.zeta, self.tangent, curvature, self.weight)
        self.kernel = kernel.T
        self._factors = lu_factor(np.eye(count) + self.reflection * self.kernel)

    def charge(self, flux: np.ndarray) -> np.ndarray:
        """(nodes, k): charge that fields of this flux (nodes, k) through the edge leave on it."""
        return lu_solve(self._factors, -self.reflection * flux)

    def near(self, other: Circle) -> "PatchNodes":
        """Nodes that resolve what another circle near this one does; the even ones where far."""
        apart = self.gap(other) / self.radius
        if apart > 0 and self.digits / np.log1p(apart) <= len(self.t):
            return PatchNodes(self, self.t, self.zeta, self.dzeta, None)
        start = np.angle(other.centre - self.centre)
        panels = (LONGEST_PANEL, self.accuracy.rim_gap, self.accuracy.panel_nodes)
        stop = start + 2.0 * np.pi
        t, weight = self.panels(start, stop, other, lambda t: np.inf, panels)
        zeta, tangent = self.mapped(t, 1)
        half = 0.5 * (t[:, None] - self.t)
        count = len(self.t)
        with np.errstate(divide="ignore", invalid="ignore"):
            dirichlet = np.sin(count * half) / (count * np.tan(half))
        spread = np.where(np.abs(np.sin(half)) < 1e-14, 1.0, dirichlet)
        return PatchNodes(self, t, zeta, tangent * weight, spread, weight)


@dataclass(frozen=True)
class PatchNodes:
    """Nodes of a patch's edge for one touch; `spread` (nodes, even nodes) is the trigonometric
    interpolation from the even ones, None where these are they."""

    edge: PatchEdge
    t: np.ndarray
    zeta: np.ndarray
    dzeta: np.ndarray
    spread: np.ndarray | None
    weight: np.ndarray | None = None

    def even(self, charge: np.ndarray) -> np.ndarray:
        """(even nodes, k): the charges that act alike on whatever is smooth along the edge."""
        return charge if self.spread is None else self.spread.T @ charge

    def charge(self, flux: np.ndarray) -> np.ndarray:
        """(nodes, k): charge that fields of this flux (nodes, k) through the edge leave on it."""
        even = self.edge.charge(self.even(flux))
        if self.spread is None:
            return even
        return -self.edge.reflection * (flux + self._own_flux(even))

    def _own_flux(self, even: np.ndarray) -> np.ndarray:
        assert self.spread is not None and self.weight is not None
        per_angle = (self.edge.kernel @ even) / self.edge.weight[:, None]
        return self.weight[:, None] * (self.spread @ per_angle)

    def charge_within(self, flux: np.ndarray, within: np.ndarray) -> np.ndarray:
        """(nodes, k): charge on the nodes `within` alone, at which it answers the flux there."""
        charge = np.zeros_like(flux)
        if within.all():
            return self.charge(flux)
        assert self.spread is not None and self.weight is not None  # even ones are all within
        part = self.spread[within]
        kernel = self.edge.kernel / self.edge.weight[:, None]
        own = self.weight[within, None] * (part @ kernel @ part.T)
        system = np.eye(len(part)) + self.edge.reflection * own
        charge[within] = np.linalg.solve(system, -self.edge.reflection * flux[within])
        return charge


@dataclass(frozen=True)
class BareTouch:
    """A touch as it is on the skin without its patch: its edge, with the nodes that it has beside
    the patch, and what its multipoles are to the electrodes' modes (n order, 2 degree), before the
    electrodes' own modes relax."""

    edge: TouchEdge
    coupling: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        arrays = [v for v in vars(self.edge).values() if isinstance(v, np.ndarray)]
        return self.coupling.nbytes + sum(one.nbytes for one in arrays)


@dataclass(frozen=True)
class PatchedTouch:
    """A touch on a patched skin: what TouchEdge and its coupling are to an even one.

    mass, self_response (2 degree, 2 degree) of multipoles of the patched skin; coupling (n order,
    2 degree) to the electrodes' modes, before the electrodes' own modes relax. factor: the skin's
    in the touch, None where the patch's edge goes through it; nodes: of the patch's edge; charge
    (nodes, 2 degree): what the multipoles leave on them.
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
    def on_patch(cls, touch: Touch, patch: PatchEdge, forward: "PatchForward") -> "PatchedTouch":
        """A touch that covers the patch and no more: its factor and the patch's are of one disc."""
        edge = TouchEdge(touch, patch.geometry, patch.disc, forward.accuracy.touch)
        factor, response = patch.factor, edge.self_response
        patched = factor * np.linalg.solve(edge.mass + (factor - 1.0) * response, edge.mass)
        coupling = forward.electrodes.project(edge.rim_response(forward.electrodes.rim)) @ patched
        own = factor * response @ patched
        return cls(touch, edge, factor * edge.mass, 0.5 * (own + own.T), coupling, None)

    @classmethod
    def by_patch(cls, touch: Touch, patch: PatchEdge, forward: "PatchForward") -> "PatchedTouch":
        """A touch beside the patch, in it, round it or across its edge."""
        bare = forward.bare_touch(touch)
        edge, nodes = bare.edge, patch.near(bare.edge)
        within = np.abs(patch.place(nodes.t) - edge.centre) < edge.radius
        inside = np.abs(edge.place(edge.t) - patch.centre) < patch.radius
        if not len(edge.crossings(patch)):
            within[:], inside[:] = within.mean() > 0.5, inside.mean() > 0.5
            if not within.any():
                factor = patch.factor if inside.any() else 1.0
                return cls._whole(touch, bare, nodes, factor, forward)
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
        kernel = neumann.rim_flux_kernel(electrodes.rim, edge.zeta, dzeta[:on_edge])
        potential = kernel @ values[:on_edge]
        if edge.clipped:
            covered = edge.covers(electrodes.rim)
            there = electrodes.rim[covered]
            potential[covered] += edge.harmonics.values(there)
            potential[covered] += neumann.potential(there[:, None], nodes.zeta) @ bend
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
    def _whole(
        cls,
        touch: Touch,
        bare: BareTouch,
        nodes: PatchNodes,
        factor: float,
        forward: "PatchForward",
    ) -> "PatchedTouch":
        """A touch that no edge of the patch goes through, where the skin's factor is this one: what
        it is on the bare skin, and what the patch's charge adds."""
        edge = bare.edge
        rim = np.exp(1j * edge.rim_theta)
        boundary = np.concatenate([edge.zeta, rim])
        flux = np.concatenate([edge.flux, edge.rim_flux])
        into_patch = neumann.flux_kernel(boundary[:, None], nodes.zeta, nodes.dzeta)
        charge = nodes.charge(into_patch.T @ flux)
        met = flux.T @ (neumann.potential(boundary[:, None], nodes.zeta) @ charge)
        response = factor * (edge.self_response + 0.5 * (met + met.T))
        coupling = bare.coupling + forward.at_patch.T @ nodes.even(charge)
        mass = factor * edge.mass
        return cls(touch, edge, mass, response, coupling, factor, nodes, charge)


class PatchForward(Forward):
    """A skin with a patch, ready to be touched at one place; as Forward otherwise.

    Raises InputError for a patch at the rim, and for one on a skin whose conductivity rises across
    it. In a body, a patch reaches through the whole depth, and it and touches beside it couple to
    the mean over the depth alone.
    """

    touch_effort = PATCHED * Forward.touch_effort
    patch: PatchEdge
    at_patch: np.ndarray
    change: np.ndarray

    def __init__(self, bare: Forward, geometry: Geometry, near: Forward | None = None):
        """`bare`: the same skin without its patch; `near`: a solved skin, to share with."""
        vars(self).update(vars(bare))
        self.bare, self.geometry = bare, geometry
        self.effort, self.touch_effort = bare.effort, PATCHED * bare.touch_effort
        if bare.bulk:
            raise InputError("skin", "patch", "a gradient of the conductivity", "none")
        if (
            isinstance(near, PatchForward)
            and near.geometry.patch == geometry.patch
            and near.bare.matches(bare.geometry, bare.accuracy, bare.electrodes.order)
        ):
            self.patch, self.at_patch = near.patch, near.at_patch
            self._kept = near._kept
            change = near.change
        else:
            self.patch = PatchEdge(geometry, bare.disc, bare.accuracy.touch)
            self._kept = KeptTouches()
            self.at_patch = self._at_patch(bare.electrodes)
            change = self._change(bare.electrodes)
        self.change = change
        self._relax_electrodes(bare.electrodes.matrix + change)

    @property
    def nbytes(self) -> int:
        """As Forward's, with the skin without its patch and what the patch changes."""
        return super().nbytes + self.bare.nbytes + self.change.nbytes

    def bare_touch(self, touch: Touch) -> BareTouch:
        """A touch as it is without the patch, but for its nodes; kept with the bare skin where
        these are even: graded ones serve this patch alone."""
        geometry, accuracy = self.geometry, self.accuracy.touch

        def found() -> BareTouch:
            edge = TouchEdge(touch, geometry, self.patch.disc, accuracy, beside=self.patch)
            coupling = self.electrodes.project(edge.rim_response(self.electrodes.rim))
            return BareTouch(edge, coupling)

        def serves(kept: BareTouch) -> bool:
            return kept.edge.serves_beside(self.patch)

        place = touch.x_mm, touch.y_mm, touch.radius_mm
        return self.bare._kept.get(BareTouch, place, found, serves)

    def _new(self, places: list[Place]) -> dict[Place, Coupled]:
        """None: touches as they are without the patch are kept, and found one by one."""
        return {}

    def _at_patch(self, electrodes: Electrodes) -> np.ndarray:
        """(even nodes, n order): potentials of the electrodes' modes on the patch's edge."""
        return electrodes.project(neumann.potential(electrodes.rim[:, None], self.patch.zeta)).T

    def _change(self, electrodes: Electrodes) -> np.ndarray:
        """(n order, n order): what the patch changes of the power of the electrodes' modes."""
        flux = neumann.rim_flux_kernel(electrodes.rim, self.patch.zeta, self.patch.dzeta)
        change = self.at_patch.T @ self.patch.charge(electrodes.project(flux).T)
        return 0.5 * (change + change.T)

    def edge(  # type: ignore[override]  # what it makes of touches only it meets again
        self, touch: Touch, apart: float = np.inf
    ) -> PatchedTouch:
        """The touch's multipoles in the patched skin. Raises InputError for several touches."""
        if np.isfinite(apart):
            raise InputError("touch", "touches", "several on a patched skin", "one")
        offset = abs(touch.x_mm + 1j * touch.y_mm - self.patch.centre)
        if offset + abs(touch.radius_mm - self.patch.radius) < SAME_CIRCLE * self.patch.radius:
            return PatchedTouch.on_patch(touch, self.patch, self)
        return PatchedTouch.by_patch(touch, self.patch, self)

    def _to_electrodes(self, edge: PatchedTouch) -> np.ndarray:  # type: ignore[override]
        return edge.coupling

    def _even_current(self, edge: PatchedTouch) -> Entered:  # type: ignore[override]
        """As Forward's. Raises InputError for a touch that covers a part of the patch's edge."""
        if edge.factor is None:
            place = f"({edge.touch.x_mm:g}, {edge.touch.y_mm:g}) mm, across a patch's edge"
            raise InputError("touch", "leak at the touch", place, "a touch on either side of it")
        assert edge.nodes is not None
        current, nodes, rim = EvenCurrent(edge.edge), edge.nodes, self.electrodes.rim
        charge = nodes.charge(current.flux(nodes.zeta, nodes.dzeta)[:, None] / edge.factor)
        at_nodes = current.potential(nodes.zeta)
        direct = self.electrodes.project(current.potential(rim)[:, None]) / edge.factor
        to_electrodes = direct + self.at_patch.T @ nodes.even(charge)
        to_touch = current.mean_response(edge.edge) + at_nodes @ edge.charge
        power = current.power / edge.factor + float(at_nodes @ charge[:, 0])
        inner_power = current.inner_power / edge.factor
        return Entered(to_electrodes[:, 0], to_touch, power, inner_power)

    def derivatives(
        self, touches: Sequence[Touch] = (), parameters: list[str] | None = None
    ) -> NoReturn:
        """None is known: raises InputError."""
        raise InputError("skin", "patch", "one", "none, to differentiate")
