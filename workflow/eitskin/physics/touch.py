"""A touch: a sharp-edged disc in which the conductivity is multiplied by 1 + contrast.

Inside it the potential is harmonic, so its multipoles up to a degree describe it; the edge is an
exact circle of the skin, mapped onto the unit disc, and cuts no element of any mesh. A touch that
reaches beyond the rim is clipped by it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.arrays import as_in, library
from eitskin.physics.conformal import DiscMap, MapVelocity
from eitskin.physics.geometry import Geometry, RimMotion
from eitskin.physics.gradient import GradientBulk
from eitskin.physics.harmonics import Harmonics, RimField, symmetric
from eitskin.physics.rim_curve import distance, inside

# Nodes of a touch's edge: sizes with fast, even steps of about sqrt(2), as many as a touch may
# have.
NODE_COUNTS = (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
MOST_EVEN_NODES = 128  # an edge that would need more, near the rim, has graded nodes
# At a crossing at right angles the shortest panel, in radians, and the nodes of all panels.
CROSSED_PANEL = 0.03
CROSSED_NODES = 6
SHORTEST_CROSSED_PANEL = 1e-6  # radians; bounds the number of panels at a flat crossing
TANGENT_SINE2 = 1e-5  # squared sine of the crossing angle below which circles count as tangent
MOST_NEWTON_STEPS, LAST_NEWTON_STEP = 60, 1e-11  # of the search for a crossing; radians
MOST_ARCS = 2  # of an edge on the skin, where a corner lies beyond it
MOST_PANELS = 150  # between two crossings: bounds the cost of circles that nearly coincide
# Angles at which the distance of an edge to the rim is evaluated.
EDGE_ANGLES = np.linspace(0.0, 2.0 * np.pi, 512, endpoint=False)
OFF_SKIN: dict[str, Any] = {"over": "ignore", "invalid": "ignore"}  # where the map says nothing
ROUGH_STRIDE = 4  # every fourth of EDGE_ANGLES gives the distance to the rim of a touch far from it
ROUGH_MARGIN = 0.1  # radii; a touch nearer to the rim is measured at all EDGE_ANGLES

Clearance = Callable[[np.ndarray], np.ndarray | float]


class PanelSizes(NamedTuple):
    """Lengths of the longest and the shortest panel, nodes of each, and the most panels."""

    longest: float
    shortest: float
    nodes: int
    most_panels: float = np.inf


@dataclass(frozen=True)
class Touch:
    """Centre and radius in mm, skin frame; conductivity inside is (1 + contrast) times that
    outside.

    Raises InputError for a radius of 0 or less and a contrast of -1 or less.
    """

    x_mm: float
    y_mm: float
    radius_mm: float
    contrast: float = 0.0

    def __post_init__(self) -> None:
        if not self.radius_mm > 0:
            raise InputError("touch", "radius_mm", self.radius_mm, "more than 0")
        if not self.contrast > -1:
            raise InputError("touch", "contrast", self.contrast, "more than -1")


@dataclass(frozen=True)
class TouchAccuracy:
    """How finely a touch is resolved.

    degree: highest multipole, used where the rim is near; tolerance: relative, of expansion and
    quadrature; panel_nodes: of one panel of a graded edge; rim_gap: an edge that comes nearer to
    the rim than this, in radii, on either side, is taken to stop at this distance.
    """

    degree: int
    tolerance: float
    panel_nodes: int
    rim_gap: float

    def across(self, gap: float) -> float:
        """Number of nodes that resolve a field whose source is `gap` radii away: ln(1 /
        tolerance) / ln(1 + gap); infinite for a gap of 0 or less."""
        return float(-np.log(self.tolerance) / np.log1p(gap)) if gap > 0 else np.inf

    def resolution(self, needed_nodes: float) -> tuple[int, int]:
        """Highest multipole and number of even nodes of an edge that needs so many nodes."""
        degree = int(min(self.degree, max(np.ceil(0.5 * needed_nodes), 3)))
        least_nodes = max(needed_nodes, 2 * degree + 4)
        return degree, next((n for n in NODE_COUNTS if n >= least_nodes), NODE_COUNTS[-1])


@dataclass(frozen=True)
class EdgeMotion:
    """Velocities of the nodes of a TouchEdge with one parameter (first and second by the angle)."""

    zeta: np.ndarray
    tangent: np.ndarray
    curvature: np.ndarray


class Circle:
    """A circle of the skin, centre (complex) and radius in mm, mapped onto the unit disc.

    Of several at once, centre and radius (P, 1), `place` and `mapped` give (P, points). Angles are
    arrays of the same library as these. Of several skins, geometry and disc are Unfoldings and
    DiscMaps.
    """

    def __init__(self, centre: Any, radius: Any, geometry: Any, disc: Any):
        self.centre, self.radius = centre, radius
        self.geometry, self.disc = geometry, disc

    def place(self, t: np.ndarray) -> np.ndarray:
        """The skin's points, mm, at angles t."""
        return self.centre + self.radius * library(t).exp(1j * t)

    def mapped(self, t: np.ndarray, order: int) -> list[np.ndarray]:
        """Points of the unit disc at angles t and their derivatives by t up to `order` <= 2."""
        ray = self.radius * library(t).exp(1j * t)
        f = self.disc.derivatives(self.geometry.unfold(self.centre + ray), order)
        place_slope = self.geometry.unfold(1j * ray)
        mapped = [f[0]]
        if order >= 1:
            mapped.append(f[1] * place_slope)
        if order >= 2:
            mapped.append(f[2] * place_slope**2 + f[1] * self.geometry.unfold(-ray))
        return mapped

    def select(self, indices: np.ndarray) -> "Circle":
        """The circles at `indices`, integers or a mask."""
        return Circle(self.centre[indices], self.radius[indices], self.geometry, self.disc)

    def rim_gaps(self) -> np.ndarray:
        """(P,): distance to the rim of several, as mapped onto the unit disc and in their radii
        there; below 0 for one that crosses it. Of an outline that distance, or to a corner in the
        radii themselves, whichever is smaller."""
        with np.errstate(**OFF_SKIN):
            gaps = _gaps(self.mapped(as_in(EDGE_ANGLES[::ROUGH_STRIDE], self.radius), 0)[0])
            uncertain = ~(gaps >= ROUGH_MARGIN)
            if uncertain.any():
                gaps[uncertain] = _gaps(
                    self.select(uncertain).mapped(as_in(EDGE_ANGLES, self.radius), 0)[0]
                )
        if self.geometry.outline:
            return self._gaps_to_outline(gaps)
        return gaps

    def _gaps_to_outline(self, gaps: np.ndarray) -> np.ndarray:
        """(P,): `gaps` where the circles lie within the outline; else, below 0, how far they reach
        beyond, in radii: there the map says nothing."""
        rim, corners = self.geometry.drawn_rim, self.geometry.corners
        centre, radius = self.centre[:, 0], self.radius[:, 0]
        if len(corners):
            to_corner = np.abs(centre[:, None] - corners).min(axis=1)
            gaps = np.minimum(gaps, np.abs(to_corner / radius - 1.0))
        near = np.flatnonzero(~(distance(rim, centre) > radius) | ~inside(rim, centre))
        if len(near):
            edge = self.select(near).place(EDGE_ANGLES)
            beyond = np.where(inside(rim, edge), 0.0, distance(rim, edge))
            reach = beyond.max(axis=1) / radius[near]
            gaps[near] = np.where(reach > 0, -reach, np.minimum(gaps[near], 0.0))
        return gaps

    def rim_gap(self) -> float:
        """The rim_gaps of a single circle."""
        centre, radius = np.array([[self.centre]]), np.array([[self.radius]])
        return float(Circle(centre, radius, self.geometry, self.disc).rim_gaps()[0])

    def gap(self, circle: "Circle") -> float:
        """Least distance between the two circles, mm; 0 where they cross."""
        distance = abs(self.centre - circle.centre)
        gap = max(
            distance - self.radius - circle.radius, abs(self.radius - circle.radius) - distance
        )
        return max(gap, 0.0)

    def angle_sine2(self, circle: "Circle") -> float:
        """Squared sine of the angle at which another circle crosses this one; 0 without a
        crossing."""
        a, b, d = self.radius, circle.radius, abs(self.centre - circle.centre)
        return max(1.0 - ((a**2 + b**2 - d**2) / (2.0 * a * b)) ** 2, 0.0)

    def crossings(self, circle: "Circle") -> np.ndarray:
        """The two angles t at which another circle crosses this one; empty where the circles do
        not cross or are tangent."""
        if self.angle_sine2(circle) < TANGENT_SINE2:
            return np.zeros(0)
        step = circle.centre - self.centre
        distance = abs(step)
        cosine = (distance**2 + self.radius**2 - circle.radius**2) / (2.0 * distance * self.radius)
        turn = np.arccos(np.clip(cosine, -1.0, 1.0))
        return (np.angle(step) + np.array([-turn, turn])) % (2.0 * np.pi)

    def panels(
        self,
        start: float,
        stop: float,
        neighbour: "Circle | None",
        clearance: Clearance,
        panels: PanelSizes,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights from start to stop by graded_panels with `clearance` and `panels`.

        Panels also shrink towards a neighbouring circle. Where it crosses this one panels end, and
        they shrink the more the flatter the crossing.
        """
        if neighbour is None:
            return graded_panels(start, stop, clearance, panels)
        crossings = self.crossings(neighbour)
        if len(crossings):
            size = min(neighbour.radius / self.radius, 1.0)
            shortest = max(
                CROSSED_PANEL * size * self.angle_sine2(neighbour), SHORTEST_CROSSED_PANEL
            )
            longest = panels.longest * CROSSED_NODES / panels.nodes
            panels = PanelSizes(longest, shortest, CROSSED_NODES)

        def joint_clearance(t: np.ndarray) -> np.ndarray:
            gap = np.abs(np.abs(self.place(t) - neighbour.centre) - neighbour.radius) / self.radius
            for crossing in crossings:
                gap = np.minimum(gap, np.abs(np.sin(0.5 * (t - crossing))))
            return np.minimum(clearance(t), gap)

        between = start + (crossings - start) % (2.0 * np.pi)
        panel_ends = np.unique([start, *between[between < stop], stop])
        panels = panels._replace(most_panels=MOST_PANELS)
        parts = [graded_panels(a, b, joint_clearance, panels) for a, b in pairwise(panel_ends)]
        node, weight = zip(*parts, strict=True)
        return np.concatenate(node), np.concatenate(weight)


@dataclass(frozen=True)
class Surroundings:
    """What a touch must resolve besides the rim: the distance to the nearest other touch, in its
    radii, and a circle at which the conductivity jumps."""

    touch_clearance: float = np.inf
    circle: Circle | None = None


ALONE = Surroundings()


class TouchEdge(Circle):
    """The boundary of a touch in the unit disc, its multipoles, and how they interact with it.

    Nodes on the edge are evenly spaced, or graded towards the rim and towards the circle of its
    `surroundings` where the touch comes near them; a part of the rim closes a clipped touch. bulk:
    the correction for a conductivity that rises across the skin. Raises InputError for a touch
    outside the skin or one that the rim cuts more than twice.
    """

    def __init__(
        self,
        touch: Touch,
        geometry: Geometry,
        disc: DiscMap,
        accuracy: TouchAccuracy,
        surroundings: Surroundings = ALONE,
        bulk: GradientBulk | None = None,
    ):
        super().__init__(touch.x_mm + 1j * touch.y_mm, touch.radius_mm, geometry, disc)
        self.touch, self.bulk, self.accuracy = touch, bulk, accuracy
        degree = self._place_nodes(surroundings.touch_clearance, surroundings.circle)
        boundary = np.concatenate([self.zeta, np.exp(1j * self.rim_theta)])
        self.harmonics = Harmonics.around(boundary, degree)
        self._build_modes()

    def _place_nodes(self, touch_clearance: float, neighbour: Circle | None) -> int:
        """Place the nodes on the edge; returns the highest multipole needed."""
        accuracy = self.accuracy
        gap = self.rim_gap()
        if not (gap >= 0 or (np.isfinite(gap) and self._lies_on_skin())):
            place = f"({self.touch.x_mm:g}, {self.touch.y_mm:g}) mm"
            raise InputError("touch", "place", place, "a place on the skin")
        self.held_off = bool(abs(gap) < accuracy.rim_gap)
        if self.held_off:
            self.radius *= 1.0 + gap - accuracy.rim_gap
            gap = accuracy.rim_gap
        self.rim_nodes = self.accuracy.across(gap)
        touch_nodes = min(self.accuracy.across(touch_clearance), NODE_COUNTS[-1])
        longest, self.even = 2.0 * touch_clearance, self.rim_nodes <= MOST_EVEN_NODES
        if neighbour:
            touch_nodes = self._neighbour_nodes(neighbour)
            self.even = self.even and touch_nodes <= MOST_EVEN_NODES
        degree, count = self.accuracy.resolution(max(self.rim_nodes, touch_nodes))
        longest = min(0.5 * accuracy.panel_nodes / degree, longest)
        panels = PanelSizes(longest, accuracy.rim_gap, accuracy.panel_nodes)
        self.rim_theta = self.rim_weight = np.zeros(0)
        self.clipped = gap < 0
        if self.clipped:
            self._clip(panels, neighbour)
        elif self.even:
            self.t, self.weight = even_nodes(count)
        else:
            rim_distance = self._rim_distance()
            nearest = EDGE_ANGLES[rim_distance.argmin()]
            end = nearest + 2.0 * np.pi
            self.t, self.weight = self.panels(
                nearest, end, neighbour, _clearance(rim_distance), panels
            )
        self.zeta, self.tangent, self.curvature = self.mapped(self.t, 2)
        return degree

    def _neighbour_nodes(self, circle: Circle) -> float:
        """Number of nodes that resolve the gap between the edge and a neighbouring circle."""
        gap = max(self.gap(circle) / self.radius, self.accuracy.rim_gap)
        return min(self.accuracy.across(gap), NODE_COUNTS[-1])

    def serves_beside(self, circle: Circle) -> bool:
        """Whether the touch would have the same nodes and multipoles with this circle as its
        neighbour."""
        touch_nodes = self._neighbour_nodes(circle)
        if self.clipped or not self.even or touch_nodes > MOST_EVEN_NODES:
            return False
        return self.accuracy.resolution(max(self.rim_nodes, touch_nodes)) == (
            self.harmonics.degree,
            len(self.t),
        )

    def _lies_on_skin(self) -> bool:
        """Whether a part of the edge lies on the skin."""
        if self.geometry.outline:
            return bool(inside(self.geometry.drawn_rim, self.place(EDGE_ANGLES)).any())
        in_range = np.abs(self.geometry.unfold(self.place(EDGE_ANGLES))) <= self.disc.scale
        return bool((in_range & (self._rim_distance() > 0)).any())

    def _rim_distance(self) -> np.ndarray:
        """(512,): distance to the rim at EDGE_ANGLES, in radians of the edge; below 0 outside."""
        with np.errstate(**OFF_SKIN):
            zeta, tangent = self.mapped(EDGE_ANGLES, 1)
            rim_distance = (1.0 - np.abs(zeta)) / np.abs(tangent)
        if self.geometry.outline:
            rim, place = self.geometry.drawn_rim, self.place(EDGE_ANGLES)
            beyond = -distance(rim, place) / self.radius
            rim_distance = np.where(inside(rim, place), np.abs(rim_distance), beyond)
        return rim_distance

    def _clip(self, panels: PanelSizes, neighbour: Circle | None) -> None:
        rim_distance = self._rim_distance()
        outside = rim_distance < 0
        leaves = np.flatnonzero(~outside & np.roll(outside, -1))
        enters = np.flatnonzero(outside & np.roll(~outside, -1))
        most = 1 if self.geometry.outline is None else MOST_ARCS
        place = f"({self.touch.x_mm:g}, {self.touch.y_mm:g}) mm"
        if not 1 <= len(leaves) <= most or self.radius > 0.5 * self.geometry.radius_mm:
            expected = "cut in two points, or at a corner in four"
            raise InputError("touch", "edge", f"{place} cut by the rim", expected)
        count = len(enters)
        crossings = self._crossings(np.concatenate([enters, leaves]), np.repeat([-1.0, 1.0], count))
        enter, leave = np.sort(crossings[:count]), crossings[count:]
        length = (leave - enter[:, None]) % (2.0 * np.pi)
        end = enter + length.min(axis=1)
        arcs = [
            self.panels(start, stop, neighbour, _clearance(rim_distance), panels)
            for start, stop in zip(enter, end, strict=True)
        ]
        self.t, self.weight = map(np.concatenate, zip(*arcs, strict=True))
        mapped = self.mapped(np.concatenate([enter, end, self.t]), 0)[0]
        theta = np.angle(mapped[: 2 * count])
        starts, stops = theta[count:], np.roll(theta[:count], -1)
        spans = (stops - starts) % (2.0 * np.pi)
        first_crossing = (theta - starts[:, None]) % (2.0 * np.pi)
        first_crossing = np.where(first_crossing > 0, first_crossing, np.inf).min(axis=1)
        if (first_crossing < spans).any():
            raise InputError("touch", "edge", f"{place} cut into pieces", "one piece")
        scale = np.abs(mapped - mapped.mean()).max()
        sizes = PanelSizes(panels.longest * scale, panels.shortest * scale, panels.nodes)

        def clearance(theta: np.ndarray) -> np.ndarray:
            return np.abs(np.exp(1j * theta)[:, None] - mapped).min(axis=1)

        parts = [
            graded_panels(start, start + span, clearance, sizes)
            for start, span in zip(starts, spans, strict=True)
        ]
        self.rim_theta, self.rim_weight = map(np.concatenate, zip(*parts, strict=True))
        self.rim_arcs = np.stack([starts, spans])

    def _crossings(self, bracket: np.ndarray, sign: np.ndarray) -> np.ndarray:
        """Angles (K,) at which the edge crosses the rim. bracket (K,): indices of the EDGE_ANGLES
        before them; sign (K,): 1 where these lie on the skin, else -1. Newton's method, with
        bisection where it leaves the bracket."""
        low = EDGE_ANGLES[bracket]
        high, t = low + EDGE_ANGLES[1], low + 0.5 * EDGE_ANGLES[1]
        for _ in range(MOST_NEWTON_STEPS):
            zeta, tangent = self.mapped(t, 1)
            size = np.abs(zeta)
            beyond = size - 1.0
            short = sign * beyond < 0.0
            low, high = np.where(short, t, low), np.where(short, high, t)
            step = beyond * size / (zeta.conj() * tangent).real
            ahead = t - step
            inside = (low <= ahead) & (ahead <= high)
            t = np.where(inside, ahead, 0.5 * (low + high))
            if (inside & (np.abs(step) < LAST_NEWTON_STEP)).all():
                break
        return t

    def _build_modes(self) -> None:
        dzeta = self.tangent * self.weight
        rim = np.exp(1j * self.rim_theta)
        drim = 1j * rim * self.rim_weight
        self.values = self.harmonics.values(self.zeta)
        self.flux = self.harmonics.flux(self.zeta, dzeta)
        self.rim_flux = self.harmonics.flux(rim, drim)
        edge = self.zeta, self.tangent, self.curvature, self.weight
        self.kernel = neumann.self_flux_kernel(*edge, jump=-0.5)
        self.rim_kernel = neumann.rim_flux_kernel(rim, self.zeta, dzeta)
        rim_values = self.harmonics.values(rim)
        if self.bulk:
            self._tilt(rim, drim, rim_values)
        mass = self.values.T @ self.flux
        response = self.flux.T @ (self.kernel @ self.values)
        if self.clipped:
            mass += rim_values.T @ self.rim_flux
            response += self.rim_flux.T @ (self.rim_kernel @ self.values)
        if self.bulk:
            response += self._tilted_response(rim)
        self.mass = symmetric(mass)
        self.self_response = self.mass + symmetric(response)

    def _tilt(self, rim: np.ndarray, drim: np.ndarray, rim_values: np.ndarray) -> None:
        """Correct the fluxes for a conductivity that rises across the skin, and set the terms that
        couple to `bulk`.

        The multipoles are those of w = sqrt(s) u; flux is the current over sqrt(s), dw/dn - b w,
        and bent is b w. spread (2 degree, terms): the multipoles' response to psi; polar_spread:
        psi's coefficients in the field of their polarisation. On the rim that field has only the
        even return current of N, whose integral is return_share (2 degree,).
        """
        assert self.bulk is not None
        bulk, place, dzeta = self.bulk, self.place(self.t), self.tangent * self.weight
        line = self.geometry.unfold(1j * (place - self.centre)) * self.weight
        self.bent = bulk.bend(self.geometry.unfold(place), line)[:, None] * self.values
        on_rim = bulk.unmapped(rim)
        rim_line = drim / self.disc.derivatives(on_rim, 1)[1]
        self.rim_bent = bulk.bend(on_rim, rim_line)[:, None] * rim_values
        self.flux = self.flux - self.bent
        self.rim_flux = self.rim_flux - self.rim_bent
        self.return_share = -self.rim_weight @ rim_values / (2.0 * np.pi)
        terms = bulk.terms(self.zeta)
        self.spread = self.flux.T @ terms + self.rim_flux.T @ bulk.terms(rim)
        self.polar_spread = self.values.T @ bulk.flux(self.zeta, dzeta) - self.bent.T @ terms
        self.polar_spread[:, 0] += self.return_share

    def _tilted_response(self, rim: np.ndarray) -> np.ndarray:
        """(2 degree, 2 degree): contribution of the charge -b w on the edge to the response.

        A node's potential at itself, of second order in b, is that of an even line of its length.
        """
        log = neumann.potential(self.zeta[:, None] + _eye(self.zeta), self.zeta)
        length = np.abs(self.tangent) * self.weight / (2.0 * np.pi)
        self_log = np.log(length * (1.0 - np.abs(self.zeta) ** 2))
        np.fill_diagonal(log, -self_log / (2.0 * np.pi))
        potential = self.values + self.kernel @ self.values + self.return_share - log @ self.bent
        on_rim = neumann.potential(rim[:, None], self.zeta) @ self.bent
        return self.rim_bent.T @ on_rim - potential.T @ self.bent

    def rim_response(self, rim: np.ndarray) -> np.ndarray:
        """(points, 2 degree): potential at rim points that the multipoles' polarisation makes."""
        dzeta = self.tangent * self.weight
        if self.even:
            response = RimField(self.harmonics, self.zeta, dzeta, self.values).potential(rim)
        else:
            response = neumann.rim_flux_kernel(rim, self.zeta, dzeta) @ self.values
        if self.bulk:
            response -= neumann.potential(rim[:, None], self.zeta) @ self.bent
        if self.clipped:
            inside = self.covers(rim)
            response[inside] += self.harmonics.values(rim[inside])
        return response

    def response_within(self, zeta: np.ndarray) -> np.ndarray:
        """(points, 2 degree): potential at points of the unit disc outside the touch that the
        multipoles' polarisation makes."""
        dzeta = self.tangent * self.weight
        return neumann.flux_kernel(zeta[:, None], self.zeta, dzeta) @ self.values

    def covers(self, rim: np.ndarray) -> np.ndarray:
        """(points,) bool: rim points within a clipped touch."""
        start, span = self.rim_arcs[:, :, None]
        return ((np.angle(rim) - start) % (2.0 * np.pi) < span).any(axis=0)

    def inner_response(self, source: "TouchEdge") -> np.ndarray:
        """(2 degree, 2 degree of source): response of these multipoles to those of another touch,
        `source`."""
        dzeta = source.tangent * source.weight
        kernel = neumann.flux_kernel(self.zeta[:, None], source.zeta, dzeta)
        response = self.flux.T @ (kernel @ source.values)
        rim = np.exp(1j * self.rim_theta)
        kernel = neumann.rim_flux_kernel(rim, source.zeta, dzeta)
        response += self.rim_flux.T @ (kernel @ source.values)
        if self.bulk:
            log = neumann.potential(self.zeta[:, None], source.zeta)
            response -= self.flux.T @ (log @ source.bent)
            log = neumann.potential(rim[:, None], source.zeta)
            response -= self.rim_flux.T @ (log @ source.bent)
        return response

    def place_motion(self, parameter: str) -> EdgeMotion:
        """Node velocities with `x_mm`, `y_mm` or `radius_mm`."""
        ray = self.radius * np.exp(1j * self.t)
        speed = {
            "x_mm": (np.ones(len(ray)), 0.0 * ray, 0.0 * ray),
            "y_mm": (1j * np.ones(len(ray)), 0.0 * ray, 0.0 * ray),
            "radius_mm": tuple(np.exp(1j * self.t) * 1j**n for n in range(3)),
        }[parameter]
        return self._edge_motion([self.geometry.unfold(s) for s in speed])

    def skin_motion(self, motion: RimMotion, map_velocity: MapVelocity) -> EdgeMotion:
        """Node velocities when the skin changes its shape or direction under the touch."""
        ray = self.radius * np.exp(1j * self.t)
        places = (self.centre + ray, 1j * ray, -ray)
        place_motion = self._edge_motion([motion.unfolding(place) for place in places])
        z = self.geometry.unfold(places[0])
        place_slope, place_bend = self.geometry.unfold(places[1]), self.geometry.unfold(places[2])
        g = map_velocity.derivatives(z, 2)
        return EdgeMotion(
            place_motion.zeta + g[0],
            place_motion.tangent + g[1] * place_slope,
            place_motion.curvature + g[2] * place_slope**2 + g[1] * place_bend,
        )

    def _edge_motion(self, speed: list[np.ndarray]) -> EdgeMotion:
        ray = self.radius * np.exp(1j * self.t)
        f = self.disc.derivatives(self.geometry.unfold(self.centre + ray), 3)
        place_slope, place_bend = self.geometry.unfold(1j * ray), self.geometry.unfold(-ray)
        return EdgeMotion(
            f[1] * speed[0],
            f[2] * speed[0] * place_slope + f[1] * speed[1],
            f[3] * speed[0] * place_slope**2
            + 2.0 * f[2] * speed[1] * place_slope
            + f[2] * speed[0] * place_bend
            + f[1] * speed[2],
        )

    def response_slope(
        self, amplitude: np.ndarray, contrast: float, motion: EdgeMotion
    ) -> np.ndarray:
        """(n, n): change of amplitude^T (self_response + mass / contrast) amplitude with a motion.

        amplitude (2 degree, n). Raises InputError for a clipped touch, whose corners would move
        too.
        """
        self._refuse_at_rim()
        w = self.weight
        dzeta, moving = self.tangent * w, motion.tangent * w
        value, flux = self.values @ amplitude, self.flux @ amplitude
        slope = self._combine(self.harmonics.powers(self.zeta, 1), amplitude)
        bend = self._combine(self.harmonics.powers(self.zeta, 2), amplitude)
        value_dot = (slope * motion.zeta[:, None]).real
        flux_dot = (bend * (motion.zeta * dzeta)[:, None] + slope * moving[:, None]).imag
        mass_dot = (1.0 + 1.0 / contrast) * (value_dot.T @ flux + value.T @ flux_dot)
        kernel_dot = self._kernel_slope(motion)
        response = self.kernel @ value
        response_dot = kernel_dot @ value + self.kernel @ value_dot
        change = mass_dot + flux_dot.T @ response + flux.T @ response_dot
        return 0.5 * (change + change.T)

    def _refuse_at_rim(self) -> None:
        if self.clipped or self.held_off:
            state = "clipped by the rim" if self.clipped else "at the rim"
            place = f"({self.touch.x_mm:g}, {self.touch.y_mm:g}) mm, {state}"
            raise InputError("touch", "derivatives", place, "a touch inside the skin")

    def _combine(self, powers: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
        half = self.harmonics.degree
        return powers @ (amplitude[:half] - 1j * amplitude[half:])

    def _kernel_slope(self, motion: EdgeMotion) -> np.ndarray:
        x, y = self.zeta[:, None], self.zeta + _eye(self.zeta)
        dy, dy_dot = self.tangent * self.weight, motion.tangent * self.weight
        step = motion.zeta - motion.zeta[:, None]
        direct = dy_dot / (y - x) - dy * step / (y - x) ** 2
        conj, conj_dot = np.conj(x), np.conj(motion.zeta[:, None])
        below = 1.0 - conj * self.zeta
        below_dot = -conj_dot * self.zeta - conj * motion.zeta
        above, above_dot = conj * dy, conj_dot * dy + conj * dy_dot
        image = above_dot / below - above * below_dot / below**2
        ratio_dot = motion.curvature / self.tangent
        ratio_dot = ratio_dot - self.curvature * motion.tangent / self.tangent**2
        np.fill_diagonal(direct, 0.5 * ratio_dot * self.weight)
        return -(direct - image).imag / (2.0 * np.pi)

    def rim_response_slope(
        self,
        rim: np.ndarray,
        rim_dot: np.ndarray,
        amplitude: np.ndarray,
        motion: EdgeMotion | None,
    ) -> np.ndarray:
        """(points, n): change of rim_response(rim) @ amplitude when rim points and edge move."""
        self._refuse_at_rim()
        y, dy = self.zeta, self.tangent * self.weight
        value = self.values @ amplitude
        step = y - rim[:, None]
        kernel_dot = dy * rim_dot[:, None] / step**2
        if motion is None:
            return -(kernel_dot.imag / np.pi) @ value
        kernel_dot = kernel_dot + motion.tangent * self.weight / step - dy * motion.zeta / step**2
        slope = self._combine(self.harmonics.powers(y, 1), amplitude)
        value_dot = (slope * motion.zeta[:, None]).real
        kernel = neumann.rim_flux_kernel(rim, y, dy)
        return -(kernel_dot.imag / np.pi) @ value + kernel @ value_dot

    def inner_response_slope(
        self,
        source: "TouchEdge",
        amplitude: np.ndarray,
        source_amplitude: np.ndarray,
        motion: EdgeMotion | None,
        source_motion: EdgeMotion | None,
    ) -> np.ndarray:
        """(n, n): change of amplitude^T inner_response(source) source_amplitude with the motions of
        both edges; None: an edge at rest."""
        self._refuse_at_rim()
        source._refuse_at_rim()
        rest_motion = EdgeMotion(*3 * [np.zeros(1, complex)])
        a, b = motion or rest_motion, source_motion or rest_motion
        x, y = self.zeta[:, None], source.zeta
        dx, dy = self.tangent * self.weight, source.tangent * source.weight
        dx_dot, dy_dot = a.tangent * self.weight, b.tangent * source.weight
        conj, conj_dot = np.conj(x), np.conj(a.zeta[:, None])
        below, below_dot = 1.0 - conj * y, -conj_dot * y - conj * b.zeta
        kernel_dot = dy_dot / (y - x) - dy * (b.zeta - a.zeta[:, None]) / (y - x) ** 2
        kernel_dot = kernel_dot - (conj_dot * dy + conj * dy_dot) / below
        kernel_dot = kernel_dot + conj * dy * below_dot / below**2
        kernel = neumann.flux_kernel(x, y, dy)
        value, flux = source.values @ source_amplitude, self.flux @ amplitude
        slope = source._combine(source.harmonics.powers(source.zeta, 1), source_amplitude)
        value_dot = (slope * (b.zeta + 0.0 * y)[:, None]).real
        field_slope = self._combine(self.harmonics.powers(self.zeta, 1), amplitude)
        bend = self._combine(self.harmonics.powers(self.zeta, 2), amplitude)
        flux_dot = (bend * (a.zeta * dx)[:, None] + field_slope * (dx_dot + 0.0 * dx)[:, None]).imag
        slope_of_kernel = -(kernel_dot.imag / (2.0 * np.pi)) @ value
        return flux_dot.T @ (kernel @ value) + flux.T @ (slope_of_kernel + kernel @ value_dot)


def _gaps(zeta: np.ndarray) -> np.ndarray:
    xp = library(zeta)
    within = xp.max(abs(zeta - xp.mean(zeta, axis=-1, keepdims=True)), axis=-1)
    return (1.0 - xp.max(abs(zeta), axis=-1)) / within


def _clearance(rim_distance: np.ndarray) -> Clearance:
    """Distance to the rim as a function of the angle, interpolated from values at EDGE_ANGLES."""
    angle, signed = np.append(EDGE_ANGLES, 2.0 * np.pi), np.append(rim_distance, rim_distance[0])
    return lambda t: np.abs(np.interp(t % (2.0 * np.pi), angle, signed))


def even_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles (count,) of evenly spaced nodes on a circle, and their quadrature weights (count,)."""
    return np.linspace(0.0, 2.0 * np.pi, count, endpoint=False), np.full(count, 2.0 * np.pi / count)


def graded_panels(
    start: float,
    stop: float,
    clearance: Clearance,
    panels: PanelSizes,
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [start, stop], in panels halved until they fit.

    A panel fits when it is no longer than the longest and no longer than twice clearance(its
    middle), the distance (in units of the parameter) to the sources that its points interact with,
    or when it is below `shortest`. Halving stops beyond `most_panels` panels.
    """
    edges = np.linspace(start, stop, int(np.ceil((stop - start) / panels.longest)) + 1)
    while True:
        middle, length = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        coarse = (length > 2.0 * clearance(middle)) & (length > panels.shortest)
        if not coarse.any() or len(edges) > panels.most_panels:
            break
        edges = np.sort(np.concatenate([edges, middle[coarse]]))
    node, weight = _gauss(panels.nodes)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + node)).ravel(), (half * weight).ravel()


@cache
def _gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(count)


def _eye(zeta: np.ndarray) -> np.ndarray:
    """Ones on the diagonal, added to differences of nodes to avoid a division by zero there."""
    return np.eye(len(zeta))
