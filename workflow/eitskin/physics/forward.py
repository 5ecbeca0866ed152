"""The forward model: electrode voltages of a touched skin, and their derivatives, without a mesh.

The unknowns are the current densities on the electrodes and the multipoles inside each touch; the
disc's own Neumann function carries the rest exactly. The power they take is one symmetric matrix
S; what the wires see is its Schur complement on the electrodes' whole currents. All forces at one
place follow from one small generalised eigenproblem, R(c) = R0 - sum_k g_k g_k^T c / (1 + c d_k),
and every derivative from R's stationarity, dR = X^T dS X.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain, starmap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, cho_factor, cho_solve, solve_triangular

from eitskin import cores
from eitskin.errors import InputError
from eitskin.physics.arrays import as_in, library
from eitskin.physics.conformal import DiscMap
from eitskin.physics.contact_current import EvenCurrent
from eitskin.physics.electrodes import ElectrodeMotion, Electrodes
from eitskin.physics.even_touches import even_touches
from eitskin.physics.geometry import Geometry, RimMotion
from eitskin.physics.gradient import GradientBulk
from eitskin.physics.kept_touches import Coupled, Entered, KeptTouches, Place
from eitskin.physics.touch import EdgeMotion, Touch, TouchAccuracy, TouchEdge

RIM_PHI = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
FEW_ROUND = np.exp(2j * np.pi * np.arange(64) / 64)
NO_CONTRAST = 1e-12  # a touch of less is none
AT_ONCE = 64  # places
TOGETHER = 32  # new places whose touches are found by one process
MANY = 16 * AT_ONCE  # places of which all is kept until they are solved
SHARED_OUT = 100.0  # sheets solved, from which on new places have processes of their own
NO_MASS = 1e-12  # beside the heaviest multipole's


@dataclass(frozen=True)
class Accuracy:
    """Size of the expansions: modes of the current on an electrode, and what a touch needs.

    electrode_order: modes where the contact's length z sigma is KNEE of the width or more; a better
    contact crowds the current at the edges and gets sqrt(KNEE width / (z sigma)) times as many, up
    to most_modes.
    """

    electrode_order: int
    touch: TouchAccuracy
    most_modes: int

    def modes(self, geometry: Geometry) -> int:
        """Modes an electrode. Raises InputError for contacts too good to be resolved."""
        if geometry.points:
            return 1
        contact = float((geometry.contact_length_mm / geometry.electrode_width_mm).min())
        if contact < BEST_CONTACT:
            found = f"{contact:.1e} for z sigma / width"
            raise InputError(
                "skin", "contact_impedivity_ohm_m2", found, f"{BEST_CONTACT:g} or more"
            )
        wanted = self.electrode_order * max(1.0, np.sqrt(KNEE / contact))
        return min(int(np.ceil(wanted)), self.most_modes)


KNEE = 0.02
BEST_CONTACT = 2e-4
ACCURACIES = {
    "train": Accuracy(8, TouchAccuracy(10, 1e-4, 6, 2e-3), 64),
    "diagnose": Accuracy(16, TouchAccuracy(24, 1e-8, 10, 5e-4), 64),
}


def channel_values(impedance: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """(..., M) V per A: u[plus] - u[minus] for unit currents from source to sink.

    impedance (..., n, n) ohm; channels (M, 4). NaN where a point electrode that drives is measured.
    """
    source, sink, plus, minus = channels.T
    return (
        impedance[..., plus, source]
        - impedance[..., plus, sink]
        - impedance[..., minus, source]
        + impedance[..., minus, sink]
    )


def measurable(values: np.ndarray) -> np.ndarray:
    """`values` (..., M) as they are. Raises InputError where a channel has none, being that of a
    point electrode that drives."""
    if np.isnan(values).any():
        where = f"channel {np.argwhere(np.isnan(values))[0][-1]} of a driven point electrode"
        raise InputError("skin", "electrode_width_mm", where, "a width above 0 for it")
    return values


@dataclass(frozen=True)
class TouchModes:
    """What one place does to the transfer impedance, for every contrast.

    gains (n, K) ohm^(1/2), poles (K,): R(c) = R0 - sum_k gains_k gains_k^T c / (1 + c poles_k). Of
    several places gains (..., n, K) and poles (..., K).
    """

    gains: np.ndarray
    poles: np.ndarray

    def weights(self, contrast: ArrayLike) -> np.ndarray:
        """(..., F, K): c / (1 + c d_k) for contrasts (F,). Raises InputError for -1 and less."""
        each = np.asarray(contrast, float)[:, None]
        if not (each > -1.0).all():
            raise InputError("touch", "contrast", each.min(), "more than -1")
        each = as_in(each, self.poles)
        return each / (1.0 + each * self.poles[..., None, :])

    def impedance_change(self, contrast: ArrayLike) -> np.ndarray:
        """(..., F, n, n) ohm: R(c) - R0."""
        gains = self.gains[..., None, :, :]
        return -(gains * self.weights(contrast)[..., None, :]) @ gains.mT

    def channel_change(self, channels: np.ndarray, contrast: ArrayLike) -> np.ndarray:
        """(..., F, M) V per A: change of every channel."""
        source, sink, plus, minus = as_in(channels, self.gains).T
        drive = self.gains[..., source, :] - self.gains[..., sink, :]
        measured = self.gains[..., plus, :] - self.gains[..., minus, :]
        return -self.weights(contrast) @ (drive * measured).mT


@dataclass(frozen=True)
class ContactModes(TouchModes):
    """A touched place with the contact as one more terminal, the last: gains (n + 1, K).

    own (n + 1, n + 1) ohm: its row, column and self term where the touch has no contrast; else 0.
    """

    own: np.ndarray

    def impedance_change(self, contrast: ArrayLike) -> np.ndarray:
        """(F, n + 1, n + 1) ohm: R(c), less the untouched skin's R0 of the electrodes."""
        return self.own + super().impedance_change(contrast)


class Forward:
    """A skin of one geometry, ready to be touched. `accuracy`: a name of ACCURACIES, or an
    Accuracy.

    Transfer impedances are in ohm between electrodes, up to a constant that no pair sees: R[i, j]
    is the potential of electrode i for a unit current that enters at j (currents sum to zero).
    Raises InputError where the rim is too rough for the conformal map.

    effort, touch_effort: what it takes to solve it and to touch it at one place, in sheets solved.
    """

    effort, touch_effort = 1.0, 0.3
    disc: DiscMap
    bulk: GradientBulk | None
    electrodes: Any  # Electrodes, of a body BodyElectrodes
    _kept: KeptTouches

    def __init__(
        self,
        geometry: Geometry,
        accuracy: str | Accuracy = "diagnose",
        near: "Forward | None" = None,
    ):
        """`near`: a solved skin; what only depends on rim and electrodes is shared where they
        agree."""
        self.geometry = geometry
        self.accuracy = ACCURACIES[accuracy] if isinstance(accuracy, str) else accuracy
        modes = self.accuracy.modes(geometry)
        if near and near.matches(geometry, self.accuracy, modes):
            self.disc, self.bulk = near.disc, near.bulk
            self._kept = near._kept
            self.electrodes = near.electrodes.with_contacts(geometry)
        else:
            self.disc = disc_map(geometry)
            self._kept = KeptTouches()
            self.bulk = GradientBulk(geometry, self.disc) if geometry.gradient_across else None
            self.electrodes = Electrodes(geometry, self.disc, modes, self.bulk)
        self.sheet_resistance = geometry.sheet_resistance_ohm
        self._relax_electrodes(self.electrodes.matrix)

    @property
    def nbytes(self) -> int:
        """Bytes of what it holds of its electrodes' modes, the factor of their matrix."""
        return 8 * len(self._inner) ** 2

    def _relax_electrodes(self, matrix: np.ndarray) -> None:
        """The electrodes' transfer impedance, their own modes at the least power, of the matrix
        (n order, n order) of the modes."""
        n, order = self.electrodes.n, self.electrodes.order
        whole = np.zeros(n * order, dtype=bool)
        whole[::order] = True
        self._whole, self._inner = np.flatnonzero(whole), np.flatnonzero(~whole)
        self._inner_factor: tuple[np.ndarray, bool] | None = None
        self._inner_currents = np.zeros((0, n))
        self._relative = matrix[np.ix_(self._whole, self._whole)]
        if len(self._inner):
            coupling = matrix[np.ix_(self._inner, self._whole)]
            inner = matrix[np.ix_(self._inner, self._inner)]
            del matrix  # as large as its factor
            try:
                self._inner_factor = cho_factor(inner, check_finite=False)
            except np.linalg.LinAlgError:
                expected = "poorer contacts, or a finer accuracy than this"
                found = self.geometry.contact_impedivity_ohm_m2.min()
                raise InputError("skin", "contact_impedivity_ohm_m2", found, expected) from None
            self._inner_currents = -cho_solve(self._inner_factor, coupling, check_finite=False)
            self._relative = self._relative + coupling.T @ self._inner_currents
            self._relative = 0.5 * (self._relative + self._relative.T)

    def matches(self, geometry: Geometry, accuracy: Accuracy, modes: int) -> bool:
        """Whether a skin of this geometry can share what depends on rim and electrodes alone."""
        same = accuracy == self.accuracy and modes == self.electrodes.order
        return same and geometry.same_outline(self.geometry)

    def transfer_impedance(self, touches: Sequence[Touch] = ()) -> np.ndarray:
        """(n, n) ohm, with any number of touches that do not overlap."""
        return self.sheet_resistance * self._solve(touches)[0]

    def voltages(self, channels: np.ndarray, touches: Sequence[Touch] = ()) -> np.ndarray:
        """(M,) V per A. Raises InputError where a point electrode that drives is measured."""
        return measurable(channel_values(self.transfer_impedance(touches), channels))

    def meets(self, places: Sequence[Place]) -> np.ndarray:
        """(P,) bool: whether discs at places (x_mm, y_mm, radius_mm) lie on the skin, at least in
        part."""
        x, y, radius = np.array(places, float).reshape(-1, 3).T[:, :, None]
        edges = self.geometry.unfold(x + 1j * y + radius * FEW_ROUND)
        near = np.abs(edges) <= self.disc.scale  # far outside the rim the map's series says nothing
        return (near & (np.abs(self.disc(np.where(near, edges, 0.0))) < 1)).any(axis=1)

    def edge(self, touch: Touch, apart: float = np.inf) -> TouchEdge:
        """The touch's edge and multipoles at this accuracy; `apart` from others, in radii."""
        return TouchEdge(
            touch, self.geometry, self.disc, self.accuracy.touch, apart, bulk=self.bulk
        )

    def place(self, x_mm: float, y_mm: float, radius_mm: float) -> TouchModes:
        """The touch at one place, for every contrast at once."""
        return self.places([(x_mm, y_mm, radius_mm)])[0]

    def places(self, places: list[Place]) -> list[TouchModes]:
        """As `place`, of each of several places (x_mm, y_mm, radius_mm); AT_ONCE, as far as they
        have as many multipoles, are solved together."""
        found: list[TouchModes] = []
        for start in range(0, len(places), MANY):
            many = places[start : start + MANY]
            known = self._new(many)
            for begin in range(0, len(many), AT_ONCE):
                found += self._places(many[begin : begin + AT_ONCE], known)
        return found

    def _new(self, places: list[Place]) -> dict[Place, Coupled]:
        """What touches at those of the places that are new are to the skin, found on several cores
        where that is worth it."""
        new = list(dict.fromkeys(place for place in places if place not in self._kept))
        some = [new[start : start + TOGETHER] for start in range(0, len(new), TOGETHER)]
        if cores.at_once() > 1 and len(new) * type(self).touch_effort >= SHARED_OUT:
            # Where that fails they are found here, and the first that cannot be is told.
            with contextlib.suppress(InputError, MemoryError):
                return dict(zip(new, chain(*cores.spread(self._coupled_of, some)), strict=True))
        return dict(zip(new, chain(*map(self._coupled_of, some)), strict=True))

    def _coupled_of(self, places: list[Place]) -> list[Coupled]:
        """What touches at several places are to the skin."""
        even = self._even(places)
        return [even.get(place) or self._coupled(place) for place in places]

    def _even(self, places: list[Place]) -> dict[Place, Coupled]:
        """What those touches are to the skin that have even nodes."""
        found: dict[Place, Coupled] = {}
        if self.bulk:
            return found
        accuracy, rim = self.accuracy.touch, self.electrodes.rim
        for here, some in even_touches(places, self.geometry, self.disc, accuracy, len(rim)):
            coupling = self.electrodes.project(some.rim_response(rim))
            each = zip(some.mass, some.self_response, coupling, strict=True)
            found.update(zip(here, starmap(Coupled, each), strict=True))
        return found

    def _places(self, places: list[Place], known: dict[Place, Coupled]) -> list[TouchModes]:
        touched = [self._coupling(place, known=known.get(place)) for place in places]
        alike: dict[int, list[int]] = {}
        for i, one in enumerate(touched):
            alike.setdefault(len(one.mass), []).append(i)
        found: dict[int, TouchModes] = {}
        for indices in alike.values():
            mass, response, coupling = (
                np.array([getattr(touched[i], name) for i in indices])
                for name in ("mass", "response", "coupling")
            )
            gains, response = self._relaxed(coupling, response)
            turn, poles = separated(mass, response)
            gains = np.sqrt(self.sheet_resistance) * gains @ turn
            found.update(zip(indices, map(TouchModes, gains, poles), strict=True))
        return [found[i] for i in range(len(places))]

    def contact(self, x_mm: float, y_mm: float, radius_mm: float) -> ContactModes:
        """The touch at one place as `place` has it, with current that enters evenly over it.

        Raises InputError for a touch that the rim clips and where the conductivity rises across
        the skin.
        """
        place = x_mm, y_mm, radius_mm
        edge = cache(lambda: self.edge(Touch(*place)))
        touch = self._coupling(place, edge)
        current = self._kept.get(Entered, place, lambda: self._even_current(edge()))
        to_touch, power = current.to_touch, np.array([[current.power]])
        gains, response = self._relaxed(
            np.column_stack([touch.coupling, current.to_electrodes]),
            np.block([[touch.response, to_touch[:, None]], [to_touch, power]]),
        )
        turn, poles = separated(touch.mass, response[:-1, :-1])
        modes = np.vstack([gains[:, :-1], response[-1, :-1]]) @ turn
        inner = np.append(np.zeros(len(gains)), np.sqrt(current.inner_power))
        own = np.zeros((len(gains) + 1, len(gains) + 1))
        own[-1, :-1] = own[:-1, -1] = gains[:, -1]
        own[-1, -1] = response[-1, -1]
        return ContactModes(
            np.sqrt(self.sheet_resistance) * np.column_stack([modes, inner]),
            np.append(poles, 1.0),
            self.sheet_resistance * own,
        )

    def _even_current(self, edge: TouchEdge) -> Entered:
        """A current that enters evenly over a touch."""
        if self.bulk:
            found = "a gradient of the conductivity"
            raise InputError("skin", "leak at the touch", found, "none")
        current = EvenCurrent(edge)
        to_electrodes = self.electrodes.project(current.potential(self.electrodes.rim)[:, None])
        to_touch = current.mean_response(edge)
        return Entered(to_electrodes[:, 0], to_touch, current.power, current.inner_power)

    def _coupling(
        self,
        place: Place,
        edge: Callable[[], TouchEdge] | None = None,
        known: Coupled | None = None,
    ) -> Coupled:
        """The touch's multipoles at a place, kept; edge: finds the touch's, where it is known
        already; known: they themselves."""
        return self._kept.get(Coupled, place, lambda: known or self._coupled(place, edge))

    def _coupled(self, place: Place, edge: Callable[[], TouchEdge] | None = None) -> Coupled:
        found = self.edge(Touch(*place)) if edge is None else edge()
        return Coupled(found.mass, self._between(found, found), self._to_electrodes(found))

    def _to_electrodes(self, edge: TouchEdge) -> np.ndarray:
        coupling = self.electrodes.project(edge.rim_response(self.electrodes.rim))
        if self.bulk:
            coupling += self.electrodes.spread @ self.bulk.matrix @ edge.polar_spread.T
        return coupling

    def _between(self, a: TouchEdge, b: TouchEdge) -> np.ndarray:
        """(2 degree of a, 2 degree of b): response of one touch's multipoles to another's."""
        if a is b:
            response = a.self_response
        else:
            response = 0.5 * (a.inner_response(b) + b.inner_response(a).T)
        if self.bulk:
            there = a.spread @ self.bulk.matrix @ b.polar_spread.T
            back = b.spread @ self.bulk.matrix @ a.polar_spread.T
            response = response + 0.5 * (there + back.T)
        return response

    def _relaxed(self, coupling: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gains (..., n, k) and response (..., k, k) of what couples to the electrodes' modes by
        `coupling` (..., n order, k), the electrodes' own modes relaxed."""
        inner = coupling[..., self._inner, :]
        gains = coupling[..., self._whole, :] + self._inner_currents.T @ inner
        if self._inner_factor is not None:
            factor, lower = self._inner_factor
            trans = 0 if lower else 1
            columns = np.moveaxis(inner, -2, 0).reshape(len(self._inner), -1)
            columns = solve_triangular(
                factor, columns, trans=trans, lower=lower, check_finite=False
            )
            shape = (len(self._inner), *inner.shape[:-2], inner.shape[-1])
            inner = np.moveaxis(columns.reshape(shape), 0, -2)
            response = response - np.swapaxes(inner, -1, -2) @ inner
        return gains, response

    def unit_currents(self) -> np.ndarray:
        """(n order, n): currents in the electrodes' modes, each electrode driven by itself."""
        n = self.electrodes.n
        currents = np.zeros((n * self.electrodes.order, n))
        currents[self._whole, range(n)] = 1.0
        currents[self._inner] = self._inner_currents
        return currents

    def _solve(self, touches: Sequence[Touch]) -> tuple[np.ndarray, np.ndarray, list, list]:
        """Relative impedance (n, n), electrode mode currents, edges and their multipoles (2 degree,
        n)."""
        touches = [t for t in touches if abs(t.contrast) > NO_CONTRAST]
        edges = [
            self.edge(t, apart) for t, apart in zip(touches, _clearances(touches), strict=True)
        ]
        currents = self.unit_currents()
        if not edges:
            return self._relative, currents, [], []
        coupling = np.hstack([self._to_electrodes(edge) for edge in edges])
        gains = coupling[self._whole] + self._inner_currents.T @ coupling[self._inner]
        system = np.block([[self._between(a, b) for b in edges] for a in edges])
        system += block_diag(*(e.mass / t.contrast for e, t in zip(edges, touches, strict=True)))
        relaxed = np.zeros((0, coupling.shape[1]))
        if len(self._inner):
            relaxed = cho_solve(self._inner_factor, coupling[self._inner])
            system = system - coupling[self._inner].T @ relaxed
        multipoles = -np.linalg.solve(system, gains.T)
        currents[self._inner] -= relaxed @ multipoles
        split = np.split(multipoles, np.cumsum([len(edge.mass) for edge in edges])[:-1])
        change = gains @ multipoles
        return self._relative + 0.5 * (change + change.T), currents, edges, split

    def parameters(self, touches: Sequence[Touch] = ()) -> list[str]:
        """Names that `derivatives` knows; `[l]` counts electrodes, harmonics or touches."""
        g, n = self.geometry, self.electrodes.n
        names = ["conductivity_S_per_m", "thickness_mm"]
        names += [f"electrode_deg[{i}]" for i in range(n)]
        if not g.points:
            names += [f"electrode_width_mm[{i}]" for i in range(n)]
            names += [f"contact_impedivity_ohm_m2[{i}]" for i in range(n)]
        names += [f"shape_cos[{k}]" for k in g.shape_cos] + [f"shape_sin[{k}]" for k in g.shape_sin]
        names += ["stretch_x", "stretch_y", "anisotropy_ratio", "anisotropy_deg"]
        per_touch = ("x_mm", "y_mm", "radius_mm", "contrast")
        return names + [f"{p}[{i}]" for i in range(len(touches)) for p in per_touch]

    def derivatives(
        self, touches: Sequence[Touch] = (), parameters: list[str] | None = None
    ) -> dict[str, np.ndarray]:
        """d impedance / d parameter, (n, n) ohm per unit, by name; all `parameters()` by default.

        Touches of contrast 0, clipped ones and those held off the rim have none here: InputError.
        """
        if self.bulk:
            found = f"{self.geometry.gradient_across:g}"
            raise InputError("skin", "gradient_across", found, "0, to differentiate")
        for touch in touches:
            if abs(touch.contrast) <= NO_CONTRAST:
                raise InputError("touch", "contrast", touch.contrast, "one to differentiate by")
        slope = _Slopes(self, *self._solve(touches))
        wanted = self.parameters(touches) if parameters is None else parameters
        return {name: self.sheet_resistance * slope.of(name) for name in wanted}


class _Slopes:
    """dR = X^T dS X for one touched state, with X the currents and multipoles of unit drives."""

    def __init__(
        self,
        forward: Forward,
        relative: np.ndarray,
        currents: np.ndarray,
        edges: list[TouchEdge],
        multipoles: list[np.ndarray],
    ):
        self.forward, self.geometry = forward, forward.geometry
        self.relative, self.edges, self.multipoles = relative, edges, multipoles
        self.electrodes = forward.electrodes
        self.density = self.electrodes.density(currents)
        self.field = self.electrodes.field(self.density)
        self.amplitude = currents.reshape(self.electrodes.n, self.electrodes.order, -1)

    @cached_property
    def contact_blocks(self) -> np.ndarray:
        """(n, order, order): of the electrodes."""
        return self.electrodes.contact_blocks()

    def of(self, name: str) -> np.ndarray:
        kind, _, index = name.rstrip("]").partition("[")
        number: Any = int(index) if index else None
        g = self.geometry
        if kind == "thickness_mm":
            return -self.relative / g.thickness_mm
        if kind == "conductivity_S_per_m":
            drop = sum(self._contact_drop(i) for i in range(self.electrodes.n))
            return (drop - self.relative) / g.conductivity_S_per_m
        if kind == "contact_impedivity_ohm_m2":
            return self._contact_drop(number) / g.contact_impedivity_ohm_m2[number]
        if kind == "contrast":
            edge, amplitude = self.edges[number], self.multipoles[number]
            return -(amplitude.T @ edge.mass @ amplitude) / edge.touch.contrast**2
        if kind in ("x_mm", "y_mm", "radius_mm"):
            motion = self.edges[number].place_motion(kind)
            return self._moved(None, {number: motion})
        if kind == "electrode_deg":
            return self._moved(self.electrodes.angle_motion(number), {})
        if kind == "electrode_width_mm":
            return self._moved(self.electrodes.width_motion(number), {})
        return self._skin_moved(RimMotion(g, kind, number))

    def _contact_drop(self, electrode: int) -> np.ndarray:
        if self.geometry.points:
            return np.zeros_like(self.relative)
        block = self.contact_blocks[electrode]
        amplitude = self.amplitude[electrode]
        return amplitude.T @ block @ amplitude

    def _skin_moved(self, motion: RimMotion) -> np.ndarray:
        forward, g = self.forward, self.geometry
        rim = g.rim(RIM_PHI)
        velocity = g.unfold(motion.rim(RIM_PHI)) + motion.unfolding(rim)
        map_velocity = forward.disc.velocity(velocity)
        moved = {i: e.skin_motion(motion, map_velocity) for i, e in enumerate(self.edges)}
        return self._moved(self.electrodes.skin_motion(motion, map_velocity), moved)

    def _moved(
        self, electrode_motion: ElectrodeMotion | None, edge_motions: dict[int, EdgeMotion]
    ) -> np.ndarray:
        rim, density = self.electrodes.rim, self.density
        total = np.zeros_like(self.relative)
        rim_dot = np.zeros(len(rim), complex)
        if electrode_motion is not None:
            total += self.electrodes.power_slope(density, self.field, electrode_motion)
            rim, density = rim[electrode_motion.nodes], density[electrode_motion.nodes]
            rim_dot = 1j * rim * electrode_motion.rim_velocity
        for i, (edge, amplitude) in enumerate(zip(self.edges, self.multipoles, strict=True)):
            motion = edge_motions.get(i)
            change = np.zeros_like(total)
            if motion is not None or electrode_motion is not None:
                response = edge.rim_response_slope(rim, rim_dot, amplitude, motion)
                change += density.T @ response
            if motion is not None:
                contrast = edge.touch.contrast
                change += 0.5 * edge.response_slope(amplitude, contrast, motion)
            for j in range(i):
                other, other_motion = self.edges[j], edge_motions.get(j)
                if motion is None and other_motion is None:
                    continue
                there = edge.inner_response_slope(
                    other, amplitude, self.multipoles[j], motion, other_motion
                )
                back = other.inner_response_slope(
                    edge, self.multipoles[j], amplitude, other_motion, motion
                )
                change += 0.5 * (there + back.T)
            total += change + change.T
        return total


def separated(mass: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn (..., 2 degree, 2 degree) to multipoles of unit mass that respond to themselves alone,
    and how much: poles (..., 2 degree). What has no mass takes no part in them."""
    xp = library(mass)
    weight, vectors = xp.linalg.eigh(mass)
    kept = weight > NO_MASS * weight[..., -1:]
    scale = xp.where(kept, 1.0 / xp.sqrt(xp.where(kept, weight, 1.0)), 0.0)
    basis = vectors * scale[..., None, :]
    poles, turn = xp.linalg.eigh(basis.mT @ response @ basis)
    return basis @ turn, poles


def disc_map(geometry: Geometry) -> DiscMap:
    """The map of a skin onto the unit disc. Raises InputError where its rim is too rough."""
    try:
        return DiscMap(geometry.unfold(geometry.rim(RIM_PHI)))
    except ValueError as error:
        raise InputError("skin", "domain shape", str(error), "a smooth, star-shaped rim") from None


def _clearances(touches: list[Touch]) -> list[float]:
    """Distance from each touch to the nearest other edge, in its radii; InputError on overlap."""
    clearances = []
    for a in touches:
        gaps = [
            np.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm) - a.radius_mm - b.radius_mm
            for b in touches
            if b is not a
        ]
        if gaps and min(gaps) <= 0:
            found = f"two that overlap by {-min(gaps):g} mm"
            raise InputError("touch", "touches", found, "touches apart")
        clearances.append(min(gaps, default=np.inf) / a.radius_mm)
    return clearances
