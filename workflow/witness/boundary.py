"""The complete electrode model by boundary integral equations, in physical space.

The potential is a single layer on the rim and on every inclusion's edge. On the rim its density is
twice the electrodes' current density plus what is smooth, psi, so that even nodes with the
logarithm's Fourier weights resolve psi, and graded panels (`arc`) the currents:

    psi / 2 + K psi = -2 K q - (flux of the inclusions),    zeta q + u = U on an electrode,
    (1 / c + 1 / 2) rho + (flux of all else at the edge) = 0 on an edge of contrast c,

zeta = z sigma, K the normal derivative of the kernel. Factored once are the rim and the contacts;
each place adds a small system, and all forces at a place share it (Kress, Linear Integral
Equations, ch. 7 and 12; Somersalo, Cheney, Isaacson 1992).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.linalg import lu_factor, lu_solve
from scipy.special import ive

from witness.arc import HALVINGS, moment_response, segment_response
from witness.curves import Edge, Shape, close_angles, disc_edge, own_flux, rim_edge, same_curve_log
from witness.medium import Plane, Tilted, flux, potential

CLOSE = 0.15  # inclusions nearer than this share of a radius get panels


@dataclass(frozen=True)
class Resolution:
    """The least numbers of rim nodes and of Gauss nodes of an electrode's moments; digits: natural
    logarithm of the accuracy at which expansions are cut off; halvings: of an arc's panels.
    """

    rim: int = 320
    arc: int = 14
    digits: float = 18.0
    halvings: int = HALVINGS


@dataclass(frozen=True)
class Disc:
    """A circular inclusion: centre and radius, mm."""

    x_mm: float
    y_mm: float
    radius_mm: float


class Body:
    """A skin with electrodes, its contacts still open.

    shape: rim, direction, tilt; deg, width_mm (n,): electrodes, an edge at deg +- width / 2 radius;
    clearance_mm: the least distance of an inclusion's edge from the rim that is to be resolved.
    """

    def __init__(
        self,
        shape: Shape,
        deg: np.ndarray,
        width_mm: np.ndarray,
        clearance_mm: float | None = None,
        resolution: Resolution | None = None,
    ):
        self.shape, self.resolution, self.n = shape, resolution or Resolution(), len(deg)
        self.medium = Tilted(shape.slope()) if shape.tilt else Plane()
        self._arcs(np.radians(deg), np.asarray(width_mm, float) / (2.0 * shape.radius_mm))
        gap = np.inf if clearance_mm is None else clearance_mm / shape.radius_mm
        self.order = self._arc_order(gap)
        count = int(np.clip(2.0 * self.resolution.digits / gap, self.resolution.rim, 2048))
        self.edge = rim_edge(shape, count + count % 2)
        self._nodes()
        self._solve_rim()
        self._tilted: dict[tuple[int, float], np.ndarray] = {}

    def _arcs(self, centre: np.ndarray, half: np.ndarray) -> None:
        """Physical half arc lengths of the electrodes, in radii, and their ends' angles."""
        self.starts, self.stops = centre - half, centre + half
        node, weight = leggauss(40)
        phi = centre[:, None] + half[:, None] * node
        self.half_arc = 0.5 * half * (np.abs(self.shape.rim(phi, 1)) @ weight)

    def _arc_order(self, gap: float) -> int:
        """The number of Gauss nodes, by the distance of the nearest electrode or inclusion."""
        mean = 0.5 * (self.starts + self.stops)
        order = np.argsort(mean % (2.0 * np.pi))
        start, stop = self.starts[order], self.stops[order]
        gap_angle = (np.roll(start, -1) - stop) % (2.0 * np.pi)
        half = 0.5 * (stop - start)
        relative_gap = 1.0 + gap_angle / np.maximum(half, np.roll(half, -1))
        rho = (relative_gap + np.sqrt(relative_gap**2 - 1.0)).min()
        relative_clearance = gap / half.max()
        if np.isfinite(relative_clearance):
            rho = min(rho, relative_clearance + np.sqrt(relative_clearance**2 + 1.0))
        return int(np.clip(np.ceil(self.resolution.digits / np.log(rho)), self.resolution.arc, 48))

    def _nodes(self) -> None:
        """Set the Gauss nodes of every electrode, in physical arc length."""
        node = leggauss(self.order)[0]
        phi = (
            0.5 * (self.starts + self.stops)[:, None]
            + np.outer(self.stops - self.starts, node) / 2.0
        )
        arc_length = self.half_arc[:, None] * (1.0 + node)
        for _ in range(8):
            length = self._length(phi)
            phi = phi - (length - arc_length) / np.abs(self.shape.rim(phi, 1))
        slope = self.shape.rim(phi, 1)
        stretch = self.half_arc[:, None] / np.abs(slope)
        self.arc_angle = phi.ravel()
        self.arc_place = self.shape.unfold(self.shape.rim(phi)).ravel()
        unfolded = np.abs(self.shape.unfold(slope))
        self.arc_speed, self.arc_stretch = unfolded.ravel(), (unfolded * stretch).ravel()

    def _length(self, phi: np.ndarray) -> np.ndarray:
        """Arc length from an electrode's first edge to each angle."""
        node, weight = leggauss(40)
        half = 0.5 * (phi - self.starts[:, None])
        angle = self.starts[:, None, None] + half[..., None] * (1.0 + node)
        return half * (np.abs(self.shape.rim(angle, 1)) @ weight)

    def _among_arcs(self) -> np.ndarray:
        """The potential at the electrodes' nodes of their moments, without the log kernel of each
        electrode with itself."""
        n, p, place = self.n, self.order, self.arc_place
        distances = np.abs(place[:, None] - place).reshape(n, p, n, p)
        t = leggauss(p)[0]
        node_distance = np.abs(t[:, None] - t)
        np.fill_diagonal(node_distance, 1.0)
        for i in range(n):
            segment_distances = distances[i, :, i]
            np.fill_diagonal(segment_distances, self.arc_stretch[i * p : (i + 1) * p])
            distances[i, :, i] = segment_distances / node_distance
        value = -np.log(distances.reshape(n * p, n * p)) / (2.0 * np.pi)
        return 2.0 * (value + self.medium.smooth(place, place))

    def _solve_rim(self) -> None:
        edge, medium = self.edge, self.medium
        weight = edge.weight
        root, self.arc_root = medium.root(edge.place), medium.root(self.arc_place)
        length = weight.sum()

        def sink(other_root: np.ndarray) -> np.ndarray:
            """The kernel by which currents with a non-zero sum leave evenly over the rim."""
            return np.outer(1.0 / root, other_root) / length

        self.sink = sink
        matrix = 0.5 * np.eye(len(weight)) + (own_flux(medium, edge) + sink(root)) * weight
        self.factored = lu_factor(matrix)
        to_arcs = same_curve_log(self.arc_place, self.arc_angle, self.arc_speed, edge, edge.modes)
        to_arcs = to_arcs + medium.smooth(self.arc_place, edge.place)
        self.arcs_from_rim = lu_solve(self.factored, (to_arcs * weight).T, trans=1).T
        onto_rim = self._rim_from_arcs(to_arcs)
        self.rim_from_arcs = lu_solve(self.factored, -2.0 * (onto_rim + sink(self.arc_root)))
        self.among_arcs = self._among_arcs() + (to_arcs * weight) @ self.rim_from_arcs

    def _rim_from_arcs(self, to_arcs: np.ndarray) -> np.ndarray:
        """The flux of moments at the rim's nodes, its log part projected on the rim's waves."""
        edge, medium = self.edge, self.medium
        difference = edge.place[:, None] - self.arc_place
        close = np.abs(difference) < 1e-9
        difference[close] = 1.0
        value = -(edge.normal[:, None] / difference).real / (2.0 * np.pi)
        bend = np.broadcast_to(-edge.curvature[:, None] / (4.0 * np.pi), value.shape)
        value[close] = bend[close]
        if isinstance(medium, Plane):
            return value
        value = value + medium.normal_smooth(edge.place, edge.normal, self.arc_place)
        return value - medium.bend(edge.place, edge.normal)[:, None] * to_arcs.T

    def tilted_response(self, electrode: int, beta: float) -> np.ndarray:
        """(order, order): `segment_response` of an electrode on a tilted conductivity, cached."""
        key = electrode, beta
        if key not in self._tilted:
            square = self.arc_root.reshape(self.n, -1)[electrode] ** 2
            halvings = self.resolution.halvings
            self._tilted[key] = segment_response(beta * square, self.order, halvings)
        return self._tilted[key]

    def contact(self, length: np.ndarray) -> "Contact":
        """The contacts closed: length (n,) = z sigma, in radii."""
        return Contact(self, np.asarray(length, float))

    def place(self, discs: Sequence[Disc]) -> "Place":
        """Inclusions at given places, for any contrasts."""
        return Place(self, tuple(discs))


class Contact:
    """The response of the electrodes: moments Y (sqrt(s) U - v) for outer potentials v."""

    def __init__(self, body: Body, length: np.ndarray):
        n, p = body.n, body.order
        beta = length / body.half_arc
        halvings = body.resolution.halvings
        if isinstance(body.medium, Plane):
            blocks = moment_response(beta, p, halvings)
        else:
            blocks = np.array([body.tilted_response(i, b) for i, b in enumerate(beta.tolist())])
        coupled = np.einsum("ijk,ikl->ijl", blocks, body.among_arcs.reshape(n, p, n * p))
        system = np.eye(n * p) + coupled.reshape(n * p, n * p)
        block = np.zeros((n, p, n, p))
        block[range(n), :, range(n)] = blocks
        self.response = np.linalg.solve(system, block.reshape(n * p, n * p))


class Place:
    """Inclusions at definite places on a body: what they feel and what the electrodes feel."""

    def __init__(self, body: Body, discs: tuple[Disc, ...]):
        self.body, self.discs = body, discs
        self.edges = [self._edge(disc, k) for k, disc in enumerate(discs)]
        self.sizes = [len(edge.place) for edge in self.edges]

    def _edge(self, disc: Disc, index: int) -> Edge:
        """The edge of a disc: even nodes, or panels no longer than the distance to other edges."""
        body, r = self.body, self.body.shape.radius_mm
        centre, radius = complex(disc.x_mm, disc.y_mm) / r, disc.radius_mm / r
        phi = 2.0 * np.pi * np.arange(512) / 512
        to_rim = np.abs(centre - body.shape.rim(phi)).min() - radius
        if to_rim <= 0:
            raise ValueError(f"inclusion {index} leaves the skin by {-to_rim * r:g} mm")
        circles = [
            (complex(neighbour.x_mm, neighbour.y_mm) / r, neighbour.radius_mm / r)
            for k, neighbour in enumerate(self.discs)
            if k != index
        ]
        gaps = [
            max(abs(centre - c) - radius - o, abs(radius - o) - abs(centre - c)) for c, o in circles
        ]
        if min(gaps, default=np.inf) < CLOSE * radius:
            angle, span = close_angles(centre, radius, circles, to_rim)
        else:
            gap = min(to_rim, *gaps) if gaps else to_rim
            count = int(np.clip(2.0 * body.resolution.digits / np.log1p(gap / radius), 24, 1024))
            count += count % 2
            angle = 2.0 * np.pi * np.arange(count) / count
            span = np.full(count, 2.0 * np.pi / count)
        return disc_edge(body.shape, centre, radius, angle, span)

    @cached_property
    def _all_nodes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Places, normals and weights of all edges' nodes, and the rim's right-hand sides."""
        place, normal, weight = (
            np.concatenate([getattr(edge, name) for edge in self.edges])
            for name in ("place", "normal", "weight")
        )
        body, rim = self.body, self.body.edge
        on_rim = flux(body.medium, rim.place, rim.normal, place)
        on_rim = -(on_rim + body.sink(body.medium.root(place))) * weight
        return place, normal, weight, on_rim

    @cached_property
    def fluxes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The flux among edges (C, C) and at edges from moments (C, E), and the potential at
        electrodes from edges (E, C)."""
        body, medium = self.body, self.body.medium
        place, normal, weight, on_rim = self._all_nodes
        from_rim = flux(medium, place, normal, body.edge.place) * body.edge.weight
        rows = []
        for i, a in enumerate(self.edges):
            row = [
                own_flux(medium, a) if i == j else flux(medium, a.place, a.normal, b.place)
                for j, b in enumerate(self.edges)
            ]
            rows.append(np.hstack(row))
        among = np.vstack(rows) * weight + from_rim @ lu_solve(body.factored, on_rim)
        from_moments = (
            2.0 * flux(medium, place, normal, body.arc_place) + from_rim @ body.rim_from_arcs
        )
        to_electrodes = (
            potential(medium, body.arc_place, place) * weight + body.arcs_from_rim @ on_rim
        )
        return among, from_moments, to_electrodes

    @cached_property
    def _levels(self) -> tuple[np.ndarray, np.ndarray]:
        """The potential at edges from edges (C, C) and from moments (C, E)."""
        body, medium = self.body, self.body.medium
        place, _, weight, on_rim = self._all_nodes
        from_rim = potential(medium, place, body.edge.place) * body.edge.weight
        rows = []
        for i, a in enumerate(self.edges):
            speed = a.weight / a.span
            self_potential = same_curve_log(a.place, a.angle, speed, a, a.modes)
            self_potential = self_potential + medium.smooth(a.place, a.place)
            row = [
                self_potential if i == j else potential(medium, a.place, b.place)
                for j, b in enumerate(self.edges)
            ]
            rows.append(np.hstack(row))
        among = np.vstack(rows) * weight + from_rim @ lu_solve(body.factored, on_rim)
        from_moments = (
            2.0 * potential(medium, place, body.arc_place) + from_rim @ body.rim_from_arcs
        )
        return among, from_moments

    def admittance(
        self, contact: Contact, contrast: Sequence[float], radial: "Radial | None" = None
    ) -> np.ndarray:
        """(n, n): currents for the electrodes' potentials above ground, in units of the sheet's
        conductance.

        contrast: of each disc; radial: the inside of the first disc, in place of its contrast.
        """
        body = self.body
        n, p = body.n, body.order
        root = body.arc_root
        unit = np.zeros((n * p, n + 1))
        unit[np.arange(n * p), np.repeat(np.arange(n), p)] = root
        unit[:, n] = -root
        moments = contact.response @ unit
        sinks = np.zeros(n + 1)
        active = [c != 0.0 or (radial is not None and k == 0) for k, c in enumerate(contrast)]
        if any(active):
            active_nodes = np.repeat(active, self.sizes)
            among, from_moments, to_electrodes = self.fluxes
            among = among[np.ix_(active_nodes, active_nodes)]
            from_moments = from_moments[active_nodes]
            to_electrodes = to_electrodes[:, active_nodes]
            contrasts = np.repeat(contrast, self.sizes)[active_nodes]
            jump = 0.5 + np.divide(
                1.0, contrasts, out=np.zeros(len(contrasts)), where=contrasts != 0.0
            )
            rows = from_moments @ moments
            if radial is not None:
                inside = slice(0, self.sizes[0])
                jump[inside] = -0.5
                if not self.edges[0].even:
                    raise ValueError("a round inclusion that another one meets")
                inner_operator = radial.operator(self.sizes[0], body)
                level_among, level_from_moments = (
                    part[active_nodes][inside] for part in self._levels
                )
                among, from_moments, rows = among.copy(), from_moments.copy(), rows.copy()
                among[inside] -= inner_operator @ level_among[:, active_nodes]
                from_moments[inside] -= inner_operator @ level_from_moments
                rows = from_moments @ moments
                rows[inside, n] -= inner_operator.sum(axis=1)
            response_to_edges = contact.response @ to_electrodes
            system = among - from_moments @ response_to_edges
            system[np.diag_indices(len(contrasts))] += jump
            density = -np.linalg.solve(system, rows)
            moments = moments - response_to_edges @ density
            place, _, weight, _ = self._all_nodes
            sinks = (body.medium.root(place) * weight)[active_nodes] @ density
        return levelled((root[:, None] * moments).reshape(n, p, n + 1).sum(axis=1), sinks)


@dataclass(frozen=True)
class Radial:
    """The admittance of a round inclusion's inside: flux over potential at its edge for each wave
    cos k theta, in units of the conductance around it, 1/mm."""

    waves: np.ndarray

    @classmethod
    def leaking(cls, radius_mm: float, contrast: float, siemens: float, sheet: float) -> "Radial":
        """A disc of `contrast` that leaks `siemens`, spread evenly, to ground; sheet: the
        conductance around it, S. Modified Bessel functions: lap u = kappa^2 u inside."""
        k = np.arange(513)
        inside = 1.0 + contrast
        x = np.sqrt(siemens / (np.pi * sheet * inside))
        order, next_order = ive(k, x), ive(k + 1, x)
        ratio = np.where(
            order > 1e-200, next_order / np.maximum(order, 1e-300), x / (2.0 * k + 2.0)
        )
        return cls(inside * (k + x * ratio) / radius_mm)

    @classmethod
    def layered(cls, radii_mm: np.ndarray, relative: np.ndarray) -> "Radial":
        """Rings from the centre out, each with its conductivity over that around; radii
        ascending."""
        k = np.arange(1, 513)
        effective = relative[0] * np.ones(len(k))
        for inner, outer, value in zip(radii_mm[:-1], radii_mm[1:], relative[1:], strict=True):
            fade = (inner / outer) ** (2 * k) * (value - effective) / (value + effective)
            effective = value * (1.0 - fade) / (1.0 + fade)
        return cls(np.append(0.0, k * effective / radii_mm[-1]))

    def operator(self, count: int, body: Body) -> np.ndarray:
        """(count, count) on even nodes, 1 / skin radii. Raises ValueError where the disc is not
        round in unfolded coordinates."""
        if body.shape.anisotropy[0] != 1.0 or not isinstance(body.medium, Plane):
            raise ValueError("round inclusions need a conductivity without direction or tilt")
        k = np.minimum(np.arange(count), count - np.arange(count))
        column = np.fft.ifft(self.waves[k] * body.shape.radius_mm).real
        index = np.arange(count)
        return column[(index[:, None] - index) % count]


def levelled(current: np.ndarray, sinks: np.ndarray) -> np.ndarray:
    """(n, n): the admittance of currents (n, n + 1), whose last column is a common level, chosen
    such that the electrodes' currents sum to those into the inclusions, `sinks` (n + 1,)."""
    total = current.sum(axis=0) + sinks
    return current[:, :-1] - np.outer(current[:, -1], total[:-1] / total[-1])
