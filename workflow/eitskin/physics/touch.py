"""A touch: a sharp-edged disc in which the conductivity is multiplied by 1 + contrast.

Inside it the potential is harmonic, so its multipoles up to a degree describe it; the edge is an
exact circle of the skin, mapped onto the unit disc, and cuts no element of any mesh. A touch that
reaches beyond the rim is clipped by it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.arrays import as_in, library
from eitskin.physics.conformal import DiscMap, MapVelocity
from eitskin.physics.geometry import Geometry, RimMotion
from eitskin.physics.gradient import GradientBulk
from eitskin.physics.harmonics import Harmonics, RimField, symmetric

NODE_COUNTS = (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
MOST_EVEN_NODES = 128  # against the rim; nearer to it, nodes are graded
# At a crossing at right angles the shortest panel, in radians, and the nodes of all panels.
CROSSED_PANEL = 0.03
CROSSED_NODES = 6
FLATTEST = 1e-6  # shortest panel, however flat the crossing
TOUCHING = 1e-5  # squared sine of a crossing so flat that the circles touch
MOST_STEPS, LAST_STEP = 60, 1e-11  # to a crossing, in radians
MOST_PANELS = 150  # from one crossing to the next
ROUND = np.linspace(0.0, 2.0 * np.pi, 512, endpoint=False)  # where an edge is looked for the rim
OFF_SKIN: dict[str, Any] = {"over": "ignore", "invalid": "ignore"}  # where the map says nothing
FEW = 4  # times fewer points tell how far the rim is
NEAR = 0.1  # radii off the rim, within which they do not

Clearance = Callable[[np.ndarray], np.ndarray | float]
Panels = tuple[float, float, int]  # longest, shortest, nodes


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
        """Nodes that resolve what is across a gap, in radii; infinitely many where there is
        none."""
        return float(-np.log(self.tolerance) / np.log1p(gap)) if gap > 0 else np.inf

    def resolution(self, wanted: float) -> tuple[int, int]:
        """Multipoles, and nodes where they are even, for so many nodes wanted."""
        degree = int(min(self.degree, max(np.ceil(0.5 * wanted), 3)))
        most = max(wanted, 2 * degree + 4)
        return degree, next((n for n in NODE_COUNTS if n >= most), NODE_COUNTS[-1])


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
        first = self.geometry.unfold(1j * ray)
        mapped = [f[0]]
        if order >= 1:
            mapped.append(f[1] * first)
        if order >= 2:
            mapped.append(f[2] * first**2 + f[1] * self.geometry.unfold(-ray))
        return mapped

    def only(self, which: np.ndarray) -> "Circle":
        """Of several, those at `which`, indices or a mask."""
        return Circle(self.centre[which], self.radius[which], self.geometry, self.disc)

    def rim_gaps(self) -> np.ndarray:
        """(P,): distance to the rim of several, as mapped onto the unit disc and in their radii
        there; below 0 for one that crosses it."""
        with np.errstate(**OFF_SKIN):
            found = _gaps(self.mapped(as_in(ROUND[::FEW], self.radius), 0)[0])
            near = ~(found >= NEAR)
            if near.any():
                found[near] = _gaps(self.only(near).mapped(as_in(ROUND, self.radius), 0)[0])
        return found

    def rim_gap(self) -> float:
        """As rim_gaps, of one."""
        centre, radius = np.array([[self.centre]]), np.array([[self.radius]])
        return float(Circle(centre, radius, self.geometry, self.disc).rim_gaps()[0])

    def gap(self, other: "Circle") -> float:
        """Least distance between the two circles, mm; 0 where they cross."""
        apart = abs(self.centre - other.centre)
        gap = max(apart - self.radius - other.radius, abs(self.radius - other.radius) - apart)
        return max(gap, 0.0)

    def angle_sine2(self, other: "Circle") -> float:
        """Squared sine of the angle at which another circle crosses this one; 0 where none does."""
        a, b, d = self.radius, other.radius, abs(self.centre - other.centre)
        return max(1.0 - ((a**2 + b**2 - d**2) / (2.0 * a * b)) ** 2, 0.0)

    def crossings(self, other: "Circle") -> np.ndarray:
        """The two angles t at which another circle crosses this one; none where they only touch."""
        if self.angle_sine2(other) < TOUCHING:
            return np.zeros(0)
        apart = other.centre - self.centre
        d = abs(apart)
        cosine = (d**2 + self.radius**2 - other.radius**2) / (2.0 * d * self.radius)
        turn = np.arccos(np.clip(cosine, -1.0, 1.0))
        return (np.angle(apart) + np.array([-turn, turn])) % (2.0 * np.pi)

    def panels(
        self,
        start: float,
        stop: float,
        other: "Circle | None",
        clearance: Clearance,
        panels: Panels,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights from start to stop by graded_panels with `clearance` and `panels`.

        Panels also keep clear of another circle; where it crosses this one they end, and shrink
        towards it, the further the flatter it crosses.
        """
        if other is None:
            return graded_panels(start, stop, clearance, *panels)
        crossings = self.crossings(other)
        if len(crossings):
            size = min(other.radius / self.radius, 1.0)
            shortest = max(CROSSED_PANEL * size * self.angle_sine2(other), FLATTEST)
            panels = (panels[0] * CROSSED_NODES / panels[2], shortest, CROSSED_NODES)

        def clear(t: np.ndarray) -> np.ndarray:
            gap = np.abs(np.abs(self.place(t) - other.centre) - other.radius) / self.radius
            for crossing in crossings:
                gap = np.minimum(gap, np.abs(np.sin(0.5 * (t - crossing))))
            return np.minimum(clearance(t), gap)

        between = start + (crossings - start) % (2.0 * np.pi)
        ends = np.unique([start, *between[between < stop], stop])
        parts = [graded_panels(a, b, clear, *panels, MOST_PANELS) for a, b in pairwise(ends)]
        node, weight = zip(*parts, strict=True)
        return np.concatenate(node), np.concatenate(weight)


class TouchEdge(Circle):
    """The boundary of a touch in the unit disc, its multipoles, and how they interact with it.

    Nodes on the edge are evenly spaced, or graded towards the rim, and towards the circle `beside`
    (an edge of the conductivity), where the touch comes near it; a part of the rim closes a
    clipped touch. `apart`: distance to the nearest other touch, in radii; `bulk`: where the
    conductivity rises across the skin. Raises InputError for a touch outside the skin or one that
    the rim cuts more than twice.
    """

    def __init__(
        self,
        touch: Touch,
        geometry: Geometry,
        disc: DiscMap,
        accuracy: TouchAccuracy,
        apart: float = np.inf,
        beside: Circle | None = None,
        bulk: GradientBulk | None = None,
    ):
        super().__init__(touch.x_mm + 1j * touch.y_mm, touch.radius_mm, geometry, disc)
        self.touch, self.bulk, self.accuracy = touch, bulk, accuracy
        degree = self._place_nodes(apart, beside)
        boundary = np.concatenate([self.zeta, np.exp(1j * self.rim_theta)])
        self.harmonics = Harmonics.around(boundary, degree)
        self._build_modes()

    def _place_nodes(self, apart: float, beside: Circle | None) -> int:
        """Choose the nodes; returns the multipoles needed."""
        accuracy = self.accuracy
        gap = self.rim_gap()
        if not (gap >= 0 or (np.isfinite(gap) and self._meets())):
            place = f"({self.touch.x_mm:g}, {self.touch.y_mm:g}) mm"
            raise InputError("touch", "place", place, "a place on the skin")
        self.held_off = bool(abs(gap) < accuracy.rim_gap)
        if self.held_off:
            self.radius *= 1.0 + gap - accuracy.rim_gap
            gap = accuracy.rim_gap
        self.for_rim = self.accuracy.across(gap)
        for_touch = min(self.accuracy.across(apart), NODE_COUNTS[-1])
        longest, self.even = 2.0 * apart, self.for_rim <= MOST_EVEN_NODES
        if beside:
            for_touch = self._for_circle(beside)
            self.even = self.even and for_touch <= MOST_EVEN_NODES
        degree, count = self.accuracy.resolution(max(self.for_rim, for_touch))
        longest = min(0.5 * accuracy.panel_nodes / degree, longest)
        panels = (longest, accuracy.rim_gap, accuracy.panel_nodes)
        self.rim_theta = self.rim_weight = np.zeros(0)
        self.clipped = gap < 0
        if self.clipped:
            self._clip(panels, beside)
        elif self.even:
            self.t, self.weight = even_nodes(count)
        else:
            off = self._off_rim()
            nearest = ROUND[off.argmin()]
            end = nearest + 2.0 * np.pi
            self.t, self.weight = self.panels(nearest, end, beside, _clearance(off), panels)
        self.zeta, self.tangent, self.curvature = self.mapped(self.t, 2)
        return degree

    def _for_circle(self, beside: Circle) -> float:
        """Nodes that resolve what is between the edge and a circle beside it."""
        gap = max(self.gap(beside) / self.radius, self.accuracy.rim_gap)
        return min(self.accuracy.across(gap), NODE_COUNTS[-1])

    def serves_beside(self, circle: Circle) -> bool:
        """Whether nodes and multipoles are those that the touch has beside another circle."""
        for_touch = self._for_circle(circle)
        if self.clipped or not self.even or for_touch > MOST_EVEN_NODES:
            return False
        return self.accuracy.resolution(max(self.for_rim, for_touch)) == (
            self.harmonics.degree,
            len(self.t),
        )

    def _meets(self) -> bool:
        """Whether a part of the edge lies on the skin."""
        near = np.abs(self.geometry.unfold(self.place(ROUND))) <= self.disc.scale
        return bool((near & (self._off_rim() > 0)).any())

    def _off_rim(self) -> np.ndarray:
        """Distance to the rim, in radians of the edge, at the points of ROUND; below 0 outside."""
        with np.errstate(**OFF_SKIN):
            zeta, tangent = self.mapped(ROUND, 1)
            return (1.0 - np.abs(zeta)) / np.abs(tangent)

    def _clip(self, panels: Panels, beside: Circle | None) -> None:
        off = self._off_rim()
        outside = off < 0
        leaves = np.flatnonzero(~outside & np.roll(outside, -1))
        enters = np.flatnonzero(outside & np.roll(~outside, -1))
        if len(leaves) != 1 or self.radius > 0.5 * self.geometry.radius_mm:
            place = f"({self.touch.x_mm:g}, {self.touch.y_mm:g}) mm"
            raise InputError("touch", "edge", f"{place} cut by the rim", "cut twice at most")
        leave, enter = self._crossings(np.array([leaves[0], enters[0]]))
        end = leave if leave > enter else leave + 2.0 * np.pi
        self.t, self.weight = self.panels(enter, end, beside, _clearance(off), panels)
        arc = self.mapped(np.concatenate([[enter, end], self.t]), 0)[0]
        start = np.angle(arc[1])
        stop = start + (np.angle(arc[0]) - start) % (2.0 * np.pi)

        def clearance(theta: np.ndarray) -> np.ndarray:
            return np.abs(np.exp(1j * theta)[:, None] - arc).min(axis=1)

        scale = np.abs(arc - arc.mean()).max()
        self.rim_theta, self.rim_weight = graded_panels(
            start, stop, clearance, panels[0] * scale, panels[1] * scale, panels[2]
        )

    def _crossings(self, first: np.ndarray) -> np.ndarray:
        """Angles (2,) at which the edge crosses the rim, each between a point of ROUND, `first`,
        and the next: Newton's rule, halving where it leaves the bracket."""
        low = ROUND[first]
        high, t = low + ROUND[1], low + 0.5 * ROUND[1]
        sign = np.where(np.abs(self.mapped(low, 0)[0]) <= 1.0, 1.0, -1.0)
        for _ in range(MOST_STEPS):
            zeta, tangent = self.mapped(t, 1)
            size = np.abs(zeta)
            beyond = size - 1.0
            before = sign * beyond < 0.0
            low, high = np.where(before, t, low), np.where(before, high, t)
            step = beyond * size / (zeta.conj() * tangent).real
            ahead = t - step
            inside = (low <= ahead) & (ahead <= high)
            t = np.where(inside, ahead, 0.5 * (low + high))
            if (inside & (np.abs(step) < LAST_STEP)).all():
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
        self.kernel = neumann.own_flux_kernel(*edge, jump=-0.5)
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
        """Where s of `bulk` is not even: what it changes of fluxes, and the shares of `bulk`.

        The multipoles are those of w = sqrt(s) u, and flux is the current over sqrt(s), dw/dn - b
        w; bent is b w. spread (2 degree, terms): the multipoles' response to psi; polar_spread:
        psi's share of what their polarisation makes. On the rim no current of it enters but the
        even one of N, whose whole is return_share (2 degree,).
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
        """(2 degree, 2 degree): what the charge -b w on the edge adds to the response.

        Its own logarithm, of second order in b, takes a node for an even line of its length.
        """
        log = neumann.potential(self.zeta[:, None] + _eye(self.zeta), self.zeta)
        length = np.abs(self.tangent) * self.weight / (2.0 * np.pi)
        own = np.log(length * (1.0 - np.abs(self.zeta) ** 2))
        np.fill_diagonal(log, -own / (2.0 * np.pi))
        met = self.values + self.kernel @ self.values + self.return_share - log @ self.bent
        on_rim = neumann.potential(rim[:, None], self.zeta) @ self.bent
        return self.rim_bent.T @ on_rim - met.T @ self.bent

    def rim_response(self, rim: np.ndarray) -> np.ndarray:
        """(points, 2 degree): potential at rim points that the multipoles' polarisation makes."""
        dzeta = self.tangent * self.weight
        if self.even:
            response = RimField(self.harmonics, self.zeta, dzeta, self.values).at(rim)
        else:
            response = neumann.rim_flux_kernel(rim, self.zeta, dzeta) @ self.values
        if self.bulk:
            response -= neumann.potential(rim[:, None], self.zeta) @ self.bent
        if self.clipped:
            inside = self.covers(rim)
            response[inside] += self.harmonics.values(rim[inside])
        return response

    def covers(self, rim: np.ndarray) -> np.ndarray:
        """(points,): whether the touch, clipped, covers these rim points."""
        start = self.rim_theta[0]
        return (np.angle(rim) - start) % (2.0 * np.pi) < self.rim_theta[-1] - start

    def inner_response(self, other: "TouchEdge") -> np.ndarray:
        """(2 degree, 2 degree of other): response of these multipoles to those of another touch."""
        dzeta = other.tangent * other.weight
        kernel = neumann.flux_kernel(self.zeta[:, None], other.zeta, dzeta)
        response = self.flux.T @ (kernel @ other.values)
        rim = np.exp(1j * self.rim_theta)
        kernel = neumann.rim_flux_kernel(rim, other.zeta, dzeta)
        response += self.rim_flux.T @ (kernel @ other.values)
        if self.bulk:
            log = neumann.potential(self.zeta[:, None], other.zeta)
            response -= self.flux.T @ (log @ other.bent)
            log = neumann.potential(rim[:, None], other.zeta)
            response -= self.rim_flux.T @ (log @ other.bent)
        return response

    def place_motion(self, parameter: str) -> EdgeMotion:
        """Node velocities with `x_mm`, `y_mm` or `radius_mm`."""
        ray = self.radius * np.exp(1j * self.t)
        speed = {
            "x_mm": (np.ones(len(ray)), 0.0 * ray, 0.0 * ray),
            "y_mm": (1j * np.ones(len(ray)), 0.0 * ray, 0.0 * ray),
            "radius_mm": tuple(np.exp(1j * self.t) * 1j**n for n in range(3)),
        }[parameter]
        return self._moved([self.geometry.unfold(s) for s in speed])

    def skin_motion(self, motion: RimMotion, map_velocity: MapVelocity) -> EdgeMotion:
        """Node velocities when the skin changes its shape or direction under the touch."""
        ray = self.radius * np.exp(1j * self.t)
        places = (self.centre + ray, 1j * ray, -ray)
        moved = self._moved([motion.unfolding(place) for place in places])
        z = self.geometry.unfold(places[0])
        first, second = self.geometry.unfold(places[1]), self.geometry.unfold(places[2])
        g = map_velocity.derivatives(z, 2)
        return EdgeMotion(
            moved.zeta + g[0],
            moved.tangent + g[1] * first,
            moved.curvature + g[2] * first**2 + g[1] * second,
        )

    def _moved(self, speed: list[np.ndarray]) -> EdgeMotion:
        ray = self.radius * np.exp(1j * self.t)
        f = self.disc.derivatives(self.geometry.unfold(self.centre + ray), 3)
        first, second = self.geometry.unfold(1j * ray), self.geometry.unfold(-ray)
        return EdgeMotion(
            f[1] * speed[0],
            f[2] * speed[0] * first + f[1] * speed[1],
            f[3] * speed[0] * first**2
            + 2.0 * f[2] * speed[1] * first
            + f[2] * speed[0] * second
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
            where = "clipped by the rim" if self.clipped else "at the rim"
            place = f"({self.touch.x_mm:g}, {self.touch.y_mm:g}) mm, {where}"
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
        apart = y - rim[:, None]
        kernel_dot = dy * rim_dot[:, None] / apart**2
        if motion is None:
            return -(kernel_dot.imag / np.pi) @ value
        kernel_dot = kernel_dot + motion.tangent * self.weight / apart - dy * motion.zeta / apart**2
        slope = self._combine(self.harmonics.powers(y, 1), amplitude)
        value_dot = (slope * motion.zeta[:, None]).real
        kernel = neumann.rim_flux_kernel(rim, y, dy)
        return -(kernel_dot.imag / np.pi) @ value + kernel @ value_dot

    def inner_response_slope(
        self,
        other: "TouchEdge",
        amplitude: np.ndarray,
        other_amplitude: np.ndarray,
        motion: EdgeMotion | None,
        other_motion: EdgeMotion | None,
    ) -> np.ndarray:
        """(n, n): change of amplitude^T inner_response(other) other_amplitude; motions may be
        None."""
        self._refuse_at_rim()
        other._refuse_at_rim()
        still = EdgeMotion(*3 * [np.zeros(1, complex)])
        a, b = motion or still, other_motion or still
        x, y = self.zeta[:, None], other.zeta
        dx, dy = self.tangent * self.weight, other.tangent * other.weight
        dx_dot, dy_dot = a.tangent * self.weight, b.tangent * other.weight
        conj, conj_dot = np.conj(x), np.conj(a.zeta[:, None])
        below, below_dot = 1.0 - conj * y, -conj_dot * y - conj * b.zeta
        kernel_dot = dy_dot / (y - x) - dy * (b.zeta - a.zeta[:, None]) / (y - x) ** 2
        kernel_dot = kernel_dot - (conj_dot * dy + conj * dy_dot) / below
        kernel_dot = kernel_dot + conj * dy * below_dot / below**2
        kernel = neumann.flux_kernel(x, y, dy)
        value, flux = other.values @ other_amplitude, self.flux @ amplitude
        slope = other._combine(other.harmonics.powers(other.zeta, 1), other_amplitude)
        value_dot = (slope * (b.zeta + 0.0 * y)[:, None]).real
        own = self._combine(self.harmonics.powers(self.zeta, 1), amplitude)
        bend = self._combine(self.harmonics.powers(self.zeta, 2), amplitude)
        flux_dot = (bend * (a.zeta * dx)[:, None] + own * (dx_dot + 0.0 * dx)[:, None]).imag
        slope_of_kernel = -(kernel_dot.imag / (2.0 * np.pi)) @ value
        return flux_dot.T @ (kernel @ value) + flux.T @ (slope_of_kernel + kernel @ value_dot)


def _gaps(zeta: np.ndarray) -> np.ndarray:
    xp = library(zeta)
    within = xp.max(abs(zeta - xp.mean(zeta, axis=-1, keepdims=True)), axis=-1)
    return (1.0 - xp.max(abs(zeta), axis=-1)) / within


def _clearance(off: np.ndarray) -> Clearance:
    """The distance at any angle, from signed ones at the points of ROUND."""
    angle, signed = np.append(ROUND, 2.0 * np.pi), np.append(off, off[0])
    return lambda t: np.abs(np.interp(t % (2.0 * np.pi), angle, signed))


def even_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles of as many nodes evenly round a circle, and their weights."""
    return np.linspace(0.0, 2.0 * np.pi, count, endpoint=False), np.full(count, 2.0 * np.pi / count)


def graded_panels(
    start: float,
    stop: float,
    clearance: Clearance,
    longest: float,
    shortest: float,
    panel_nodes: int,
    most: float = np.inf,
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights on [start, stop], in panels halved until they fit.

    A panel fits when it is no longer than `longest` and than twice clearance(its middle), the
    distance (in units of the parameter) to what its points interact with, or when it is below
    `shortest`. Beyond `most` panels none is halved any more.
    """
    edges = np.linspace(start, stop, int(np.ceil((stop - start) / longest)) + 1)
    while True:
        middle, length = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        coarse = (length > 2.0 * clearance(middle)) & (length > shortest)
        if not coarse.any() or len(edges) > most:
            break
        edges = np.sort(np.concatenate([edges, middle[coarse]]))
    node, weight = _gauss(panel_nodes)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + node)).ravel(), (half * weight).ravel()


@cache
def _gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(count)


def _eye(zeta: np.ndarray) -> np.ndarray:
    """Ones on the diagonal keep coincident nodes apart until their limit is filled in."""
    return np.eye(len(zeta))
