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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, cho_factor, cho_solve, solve_triangular

from eitskin import cores
from eitskin.errors import InputError
from eitskin.physics.all_electrodes import RimAndInnerElectrodes
from eitskin.physics.arrays import as_in, library
from eitskin.physics.conformal import DiscMap
from eitskin.physics.contact_current import EvenCurrent
from eitskin.physics.electrode_pieces import pieces
from eitskin.physics.electrodes import ElectrodeMotion, Electrodes
from eitskin.physics.even_touches import even_touches
from eitskin.physics.geometry import Geometry, RimMotion
from eitskin.physics.gradient import GradientBulk
from eitskin.physics.poles import Fineness, RimSample, placed
from eitskin.physics.rim_curve import inside
from eitskin.physics.touch import Circle, EdgeMotion, Surroundings, Touch, TouchAccuracy, TouchEdge
from eitskin.physics.touch_cache import ContactCoupling, Place, TouchCache, TouchCoupling

# Poles of an outline's conformal map, tried in turn until its defect is FINE_DEFECT.
FINENESSES = (Fineness(20, 0.5), Fineness(28, 0.35), Fineness(40, 0.3), Fineness(56, 0.25))
# Of a curve besides: poles nearer to it, where its derivatives jump.
BESIDE_CURVES = Fineness(56, 0.3, 0.1, 1600)
# Where these do not do: most poles where the rim is most singular.
AT_INWARD_CORNERS = Fineness(20, 0.25, re_entrant=3.6)
MOST_POLES = 2000  # of a map; more take a minute
FINE_DEFECT, COARSE_DEFECT = 1e-8, 1e-5
# Times a map's defect, or that of rounding, that it may have between the points it is fitted to.
BETWEEN_SHARE, ROUNDING_DEFECT = 10.0, 1e-11
# Of a defect in the least arc of an electrode, which narrow skins crowd on the disc: wanted, most.
FINE_SHARE, COARSE_SHARE = 1e-5, 1e-4
OUTLINE_EFFORT, OUTLINE_TOUCH_EFFORT = 5.0, 0.6  # of a new map with poles, of a place on it
KEPT_MAPS = 12  # some megabytes each, of outlines

_maps: dict[tuple, DiscMap | ValueError] = {}
UNIT_CIRCLE = np.exp(2j * np.pi * np.arange(64) / 64)
LEAST_CONTRAST = 1e-12  # below this, rounding: the touch is treated as absent
PLACES_PER_SOLVE = 64  # places of one batched eigenproblem
PLACES_PER_TASK = 32  # new places that one process computes at a time
PLACES_PER_BATCH = 16 * PLACES_PER_SOLVE  # bounds the memory of couplings awaiting their solution
PARALLEL_EFFORT = 100.0  # in solved sheets; below it, starting processes costs more than it saves
SLOPE_STEP = 1e-3  # of a value, a width or the rim's mm: half a central difference
LEAST_MASS = 1e-12  # of the heaviest multipole's mass; below it a multipole is rounding


@dataclass(frozen=True)
class Accuracy:
    """Size of the expansions: modes of the current on an electrode, and the accuracy of a touch.

    electrode_order: modes where the contact length z sigma is CONTACT_KNEE of the electrode's width
    or more; a better contact crowds the current at the edges and gets
    sqrt(CONTACT_KNEE width / (z sigma)) times as many, up to most_modes.
    """

    electrode_order: int
    touch: TouchAccuracy
    most_modes: int

    def modes(self, geometry: Geometry) -> int:
        """Modes of the current on one electrode. Raises InputError for contacts too good to be
        resolved."""
        if geometry.points or not geometry.has_rim:
            return 1
        relative_lengths = geometry.contact_length_mm / geometry.electrode_width_mm
        relative_length = float(relative_lengths[geometry.on_rim].min())
        if relative_length < BEST_CONTACT:
            actual = f"{relative_length:.1e} for z sigma / width"
            raise InputError(
                "skin", "contact_impedivity_ohm_m2", actual, f"{BEST_CONTACT:g} or more"
            )
        modes = self.electrode_order * max(1.0, np.sqrt(CONTACT_KNEE / relative_length))
        return min(int(np.ceil(modes)), self.most_modes)


CONTACT_KNEE = 0.02  # z sigma / width at which the current's layer at an edge asks for more modes
BEST_CONTACT = 2e-4  # z sigma / width; below it most_modes do not resolve the layer at the edges
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
    """Return `values` (..., M) unchanged. Raises InputError where one is NaN, as it is for a
    channel that measures a driven point electrode."""
    if np.isnan(values).any():
        channel = f"channel {np.argwhere(np.isnan(values))[0][-1]} of a driven point electrode"
        raise InputError("skin", "electrode_width_mm", channel, "a width above 0 for it")
    return values


def contacts_too_good(geometry: Geometry) -> InputError:
    """The error of contacts whose current no modes at hand resolve."""
    expected = "poorer contacts, or a finer accuracy than this"
    actual = geometry.contact_impedivity_ohm_m2.min()
    return InputError("skin", "contact_impedivity_ohm_m2", actual, expected)


@dataclass(frozen=True)
class TouchModes:
    """Change of the transfer impedance by a touch at one place, for every contrast.

    gains (n, K) ohm^(1/2), poles (K,): R(c) = R0 - sum_k gains_k gains_k^T c / (1 + c poles_k). For
    several places gains (..., n, K) and poles (..., K).
    """

    gains: np.ndarray
    poles: np.ndarray

    def weights(self, contrast: ArrayLike) -> np.ndarray:
        """(..., F, K): c / (1 + c d_k) for contrasts c (F,). Raises InputError for a contrast of -1
        or less."""
        contrasts = np.asarray(contrast, float)[:, None]
        if not (contrasts > -1.0).all():
            raise InputError("touch", "contrast", contrasts.min(), "more than -1")
        contrasts = as_in(contrasts, self.poles)
        return contrasts / (1.0 + contrasts * self.poles[..., None, :])

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

    contact_impedance (n + 1, n + 1) ohm: row, column and diagonal term of that terminal for a touch
    without contrast; 0 elsewhere.
    """

    contact_impedance: np.ndarray

    def impedance_change(self, contrast: ArrayLike) -> np.ndarray:
        """(F, n + 1, n + 1) ohm: R(c), less R0 of the untouched skin between the electrodes."""
        return self.contact_impedance + super().impedance_change(contrast)


class RelaxedModes(NamedTuple):
    """The inner modes of all electrodes, which take least power for the whole currents.

    whole (n,), inner (I,): places of either in the modes; factor: Cholesky's, of the inner modes'
    power, None without such; currents (I, n): of the inner modes for unit whole currents; relative
    (n, n): power of the whole currents, the Schur complement, that is the transfer impedance.
    """

    whole: np.ndarray
    inner: np.ndarray
    factor: tuple[np.ndarray, bool] | None
    currents: np.ndarray
    relative: np.ndarray


class Forward:
    """A skin of one geometry, ready to be touched. accuracy: a name of ACCURACIES, or an Accuracy.

    Transfer impedances are in ohm between electrodes, up to a constant that cancels in every
    channel: R[i, j] is the potential of electrode i for a unit current that enters at j (currents
    sum to zero). Raises InputError where the rim is too rough for the conformal map.

    effort, touch_effort: cost of solving the skin and of one touched place, in units of one solved
    sheet.
    """

    effort, touch_effort = 1.0, 0.3
    disc: DiscMap
    bulk: GradientBulk | None
    electrodes: Any  # Electrodes, of a body BodyElectrodes
    _touch_cache: TouchCache

    def __init__(
        self,
        geometry: Geometry,
        accuracy: str | Accuracy = "diagnose",
        donor: "Forward | None" = None,
        lends_parts: bool = False,
    ):
        """`donor`: a solved skin, whose parts that depend on rim and electrodes alone are shared
        where they agree; `lends_parts`: whether this one does nothing but lend its own, so that its
        electrodes' modes need not be relaxed."""
        self._place(geometry, accuracy, donor)
        if not lends_parts:
            self.unit_currents()  # contacts too good are refused here, and tasks share the factor

    def _place(
        self, geometry: Geometry, accuracy: str | Accuracy, donor: "Forward | None" = None
    ) -> None:
        """Set the map, the electrodes and what touches need of them."""
        self.geometry = geometry
        self.accuracy = ACCURACIES[accuracy] if isinstance(accuracy, str) else accuracy
        modes = self.accuracy.modes(geometry)
        if donor and donor.matches(geometry, self.accuracy, modes):
            self.disc, self.bulk = donor.disc, donor.bulk
            self._touch_cache = donor._touch_cache
            self.electrodes = donor.electrodes.with_contacts(geometry)
        else:
            self.disc = disc_map(geometry)
            if geometry.outline:
                self.effort = OUTLINE_EFFORT
            self._touch_cache = TouchCache()
            if geometry.gradient_across and geometry.outline:
                actual, expected = f"{geometry.gradient_across:g}", "0 on a skin that is no disc"
                raise InputError("skin", "gradient_across", actual, expected)
            self.bulk = GradientBulk(geometry, self.disc) if geometry.gradient_across else None
            if geometry.electrode_inside_mm is None:
                self.electrodes = Electrodes(geometry, self.disc, modes, self.bulk)
            else:
                touch_accuracy = self.accuracy.touch
                self.electrodes = RimAndInnerElectrodes(geometry, self.disc, modes, touch_accuracy)
        if geometry.outline:
            self.touch_effort = OUTLINE_TOUCH_EFFORT
        self.sheet_resistance = geometry.sheet_resistance_ohm

    @property
    def nbytes(self) -> int:
        """Bytes of the factor of the electrodes' inner modes, there or not."""
        return 8 * (self.electrodes.size - self.electrodes.n) ** 2

    @property
    def power_matrix(self) -> np.ndarray:
        """(size, size): power of the currents in the electrodes' modes. Computed on every call."""
        return self.electrodes.matrix

    @cached_property
    def relaxed_modes(self) -> "RelaxedModes":
        """The electrodes' inner modes as the whole currents have them. Raises InputError for
        contacts too good to be resolved."""
        matrix, whole = self.power_matrix, self.electrodes.whole
        is_inner = np.ones(len(matrix), dtype=bool)
        is_inner[whole] = False
        inner = np.flatnonzero(is_inner)
        relative = matrix[np.ix_(whole, whole)]
        if not len(inner):
            return RelaxedModes(whole, inner, None, np.zeros((0, self.electrodes.n)), relative)
        coupling = matrix[np.ix_(inner, whole)]
        inner_matrix = matrix[np.ix_(inner, inner)]
        del matrix  # as large as its factor
        try:
            factor = cho_factor(inner_matrix, check_finite=False)
        except np.linalg.LinAlgError:
            raise contacts_too_good(self.geometry) from None
        currents = -cho_solve(factor, coupling, check_finite=False)
        relative = relative + coupling.T @ currents
        return RelaxedModes(whole, inner, factor, currents, 0.5 * (relative + relative.T))

    def matches(self, geometry: Geometry, accuracy: Accuracy, modes: int) -> bool:
        """Whether a skin of this geometry can share what depends on rim and electrodes alone."""
        same_expansion = accuracy == self.accuracy and modes == self.electrodes.order
        return same_expansion and geometry.same_outline(self.geometry)

    def is_model_of(self, geometry: Geometry, accuracy: str | Accuracy) -> bool:
        """Whether this is the skin of a geometry, solved at an accuracy."""
        wanted = ACCURACIES[accuracy] if isinstance(accuracy, str) else accuracy
        return wanted == self.accuracy and geometry.key() == self.geometry.key()

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
        edge_points = x + 1j * y + radius * UNIT_CIRCLE
        if self.geometry.outline:
            return np.asarray(inside(self.geometry.drawn_rim, edge_points).any(axis=1))
        edge_points = self.geometry.unfold(edge_points)
        # Far outside the rim the map's series does not converge.
        in_range = np.abs(edge_points) <= self.disc.scale
        mapped = self.disc(np.where(in_range, edge_points, 0.0))
        return (in_range & (np.abs(mapped) < 1)).any(axis=1)

    def edge(self, touch: Touch, touch_clearance: float = np.inf) -> TouchEdge:
        """The touch's edge and multipoles at this accuracy; touch_clearance: distance to the
        nearest other touch, in radii."""
        clearance = min(touch_clearance, self.clearance(touch))
        surroundings, accuracy = Surroundings(clearance), self.accuracy.touch
        return TouchEdge(touch, self.geometry, self.disc, accuracy, surroundings, self.bulk)

    def clearance(self, touch: Touch) -> float:
        """Distance of a touch from the nearest electrode inside the skin, in radii; infinite
        without any. Raises InputError for a touch that meets one."""
        centre, radius = complex(touch.x_mm, touch.y_mm), touch.radius_mm
        circle = Circle(np.array([[centre]]), np.array([[radius]]), self.geometry, self.disc)
        return float(self.electrodes.clearance(circle)[0])

    def place(self, x_mm: float, y_mm: float, radius_mm: float) -> TouchModes:
        """The modes of a touch at one place, for every contrast at once."""
        return self.places([(x_mm, y_mm, radius_mm)])[0]

    def places(self, places: list[Place]) -> list[TouchModes]:
        """The modes of touches at several places (x_mm, y_mm, radius_mm), one TouchModes each.

        Up to PLACES_PER_SOLVE places with equally many multipoles share one batched eigenproblem.
        """
        modes: list[TouchModes] = []
        for start in range(0, len(places), PLACES_PER_BATCH):
            batch = places[start : start + PLACES_PER_BATCH]
            couplings = self._new_couplings(batch)
            for block_start in range(0, len(batch), PLACES_PER_SOLVE):
                modes += self._place_modes(
                    batch[block_start : block_start + PLACES_PER_SOLVE], couplings
                )
        return modes

    def _new_couplings(self, places: list[Place]) -> dict[Place, TouchCoupling]:
        """Couplings of touches at those places that are not cached, computed on several cores where
        that is worth it."""
        new_places = list(
            dict.fromkeys(place for place in places if place not in self._touch_cache)
        )
        tasks = [
            new_places[start : start + PLACES_PER_TASK]
            for start in range(0, len(new_places), PLACES_PER_TASK)
        ]
        if cores.at_once() > 1 and len(new_places) * type(self).touch_effort >= PARALLEL_EFFORT:
            # On failure they are computed again here, so that the error names the first bad place.
            with contextlib.suppress(InputError, MemoryError):
                return dict(
                    zip(new_places, chain(*cores.spread(self._couplings, tasks)), strict=True)
                )
        return dict(zip(new_places, chain(*map(self._couplings, tasks)), strict=True))

    def _couplings(self, places: list[Place]) -> list[TouchCoupling]:
        """Couplings of touches at several places."""
        even = self._even_couplings(places)
        return [even.get(place) or self._computed_coupling(place) for place in places]

    def _even_couplings(self, places: list[Place]) -> dict[Place, TouchCoupling]:
        """Couplings of those touches whose edge has even nodes."""
        couplings: dict[Place, TouchCoupling] = {}
        if self.bulk:
            return couplings
        covers = self.electrodes.covers(places)
        places = [place for place, is_cover in zip(places, covers, strict=True) if not is_cover]
        accuracy, electrodes = self.accuracy.touch, self.electrodes
        for group, even_group in even_touches(
            places, self.geometry, self.disc, accuracy, electrodes
        ):
            coupling = electrodes.coupling(even_group)
            arrays = zip(even_group.mass, even_group.self_response, coupling, strict=True)
            couplings.update(zip(group, starmap(TouchCoupling, arrays), strict=True))
        return couplings

    def _place_modes(
        self, places: list[Place], couplings: dict[Place, TouchCoupling]
    ) -> list[TouchModes]:
        touches = [self._coupling(place, computed=couplings.get(place)) for place in places]
        for i in np.flatnonzero(self.electrodes.covers(places)).tolist():
            touches[i] = self._with_covered(places[i], touches[i])
        by_size: dict[int, list[int]] = {}
        for i, touch in enumerate(touches):
            by_size.setdefault(len(touch.mass), []).append(i)
        modes: dict[int, TouchModes] = {}
        for indices in by_size.values():
            mass, response, coupling = (
                np.array([getattr(touches[i], name) for i in indices])
                for name in ("mass", "response", "coupling")
            )
            gains, response = self._relax(coupling, response)
            turn, poles = separated_modes(mass, response)
            gains = np.sqrt(self.sheet_resistance) * gains @ turn
            modes.update(zip(indices, map(TouchModes, gains, poles), strict=True))
        return [modes[i] for i in range(len(places))]

    def contact(self, x_mm: float, y_mm: float, radius_mm: float) -> ContactModes:
        """The touch at one place with a current that enters evenly over its disc as a further
        terminal.

        Raises InputError for a touch that the rim clips and where the conductivity rises across the
        skin.
        """
        place = x_mm, y_mm, radius_mm
        if self.electrodes.covers([place])[0]:
            place_text = f"({x_mm:g}, {y_mm:g}) mm, over an electrode inside the skin"
            raise InputError("touch", "leak at the touch", place_text, "a touch beside it")
        edge = cache(lambda: self.edge(Touch(*place)))
        touch = self._coupling(place, edge)
        current = self._touch_cache.get(ContactCoupling, place, lambda: self._even_current(edge()))
        to_touch, power = current.to_touch, np.array([[current.power]])
        gains, response = self._relax(
            np.column_stack([touch.coupling, current.to_electrodes]),
            np.block([[touch.response, to_touch[:, None]], [to_touch, power]]),
        )
        turn, poles = separated_modes(touch.mass, response[:-1, :-1])
        modes = np.vstack([gains[:, :-1], response[-1, :-1]]) @ turn
        inner = np.append(np.zeros(len(gains)), np.sqrt(current.inner_power))
        contact_impedance = np.zeros((len(gains) + 1, len(gains) + 1))
        contact_impedance[-1, :-1] = contact_impedance[:-1, -1] = gains[:, -1]
        contact_impedance[-1, -1] = response[-1, -1]
        return ContactModes(
            np.sqrt(self.sheet_resistance) * np.column_stack([modes, inner]),
            np.append(poles, 1.0),
            self.sheet_resistance * contact_impedance,
        )

    def _even_current(self, edge: TouchEdge) -> ContactCoupling:
        """Coupling of a unit current that enters evenly over a touch."""
        if self.bulk:
            actual = "a gradient of the conductivity"
            raise InputError("skin", "leak at the touch", actual, "none")
        current = EvenCurrent(edge)
        to_electrodes = self.electrodes.project(current.potential(self.electrodes.nodes)[:, None])
        to_touch = current.mean_response(edge)
        return ContactCoupling(to_electrodes[:, 0], to_touch, current.power, current.inner_power)

    def _coupling(
        self,
        place: Place,
        edge_of: Callable[[], TouchEdge] | None = None,
        computed: TouchCoupling | None = None,
    ) -> TouchCoupling:
        """The cached coupling of a touch at a place; `computed`: its value where the cache has
        none; `edge_of`: returns the touch's edge, if the caller has it."""
        return self._touch_cache.get(
            TouchCoupling, place, lambda: computed or self._computed_coupling(place, edge_of)
        )

    def _computed_coupling(
        self, place: Place, edge_of: Callable[[], TouchEdge] | None = None
    ) -> TouchCoupling:
        touch_edge = self.edge(Touch(*place)) if edge_of is None else edge_of()
        return TouchCoupling(
            touch_edge.mass,
            self._mutual_response(touch_edge, touch_edge),
            self._to_electrodes(touch_edge),
        )

    def _with_covered(self, place: Place, touch: TouchCoupling) -> TouchCoupling:
        """The coupling of a touch with what it does to the electrodes inside that it covers, which
        depends on their contacts."""
        within = self.electrodes.covered(place)
        return TouchCoupling(
            block_diag(touch.mass, np.eye(len(within.response))),
            block_diag(touch.response, within.response),
            np.hstack([touch.coupling, within.coupling]),
        )

    def _to_electrodes(self, edge: TouchEdge) -> np.ndarray:
        coupling = self.electrodes.coupling(edge)
        if self.bulk:
            coupling += self.electrodes.spread @ self.bulk.matrix @ edge.polar_spread.T
        return coupling

    def _mutual_response(self, edge: TouchEdge, source: TouchEdge) -> np.ndarray:
        """(2 degree of edge, 2 degree of source): response of one touch's multipoles to
        another's."""
        if edge is source:
            response = edge.self_response
        else:
            response = 0.5 * (edge.inner_response(source) + source.inner_response(edge).T)
        if self.bulk:
            correction = edge.spread @ self.bulk.matrix @ source.polar_spread.T
            reverse_correction = source.spread @ self.bulk.matrix @ edge.polar_spread.T
            response = response + 0.5 * (correction + reverse_correction.T)
        return response

    def _relax(self, coupling: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gains (..., n, k) and response (..., k, k) of sources that couple to the electrodes'
        modes by `coupling` (..., size, k), after the electrodes' inner modes have relaxed."""
        modes = self.relaxed_modes
        inner = coupling[..., modes.inner, :]
        gains = coupling[..., modes.whole, :] + modes.currents.T @ inner
        if modes.factor is not None:
            factor, lower = modes.factor
            trans = 0 if lower else 1
            columns = np.moveaxis(inner, -2, 0).reshape(len(modes.inner), -1)
            columns = solve_triangular(
                factor, columns, trans=trans, lower=lower, check_finite=False
            )
            shape = (len(modes.inner), *inner.shape[:-2], inner.shape[-1])
            inner = np.moveaxis(columns.reshape(shape), 0, -2)
            response = response - np.swapaxes(inner, -1, -2) @ inner
        return gains, response

    def unit_currents(self) -> np.ndarray:
        """(size, n): currents in the electrodes' modes for a unit current into each electrode."""
        n, modes = self.electrodes.n, self.relaxed_modes
        currents = np.zeros((len(modes.whole) + len(modes.inner), n))
        currents[modes.whole, range(n)] = 1.0
        currents[modes.inner] = modes.currents
        return currents

    def _solve(self, touches: Sequence[Touch]) -> tuple[np.ndarray, np.ndarray, list, list]:
        """Relative impedance (n, n), currents in the electrodes' modes (size, n), edges of the
        touches and their multipoles (2 degree, n)."""
        touches = [touch for touch in touches if abs(touch.contrast) > LEAST_CONTRAST]
        edges = [
            self.edge(touch, clearance)
            for touch, clearance in zip(touches, _clearances(touches), strict=True)
        ]
        currents, modes = self.unit_currents(), self.relaxed_modes
        if not edges:
            return modes.relative, currents, [], []
        places = [(touch.x_mm, touch.y_mm, touch.radius_mm) for touch in touches]
        currents_within = {
            touch: self.electrodes.covered(place)
            for touch, place in zip(touches, places, strict=True)
            if self.electrodes.covers([place])[0]
        }
        to_electrodes = [self._to_electrodes(edge) for edge in edges]
        coupling = np.hstack(
            [*to_electrodes, *(part.coupling for part in currents_within.values())]
        )
        gains = coupling[modes.whole] + modes.currents.T @ coupling[modes.inner]
        system = np.block([[self._mutual_response(a, b) for b in edges] for a in edges])
        system += block_diag(
            *(edge.mass / touch.contrast for edge, touch in zip(edges, touches, strict=True))
        )
        for touch, part in currents_within.items():
            mass = np.eye(len(part.response))
            system = block_diag(system, part.response + mass / touch.contrast)
        relaxed = np.zeros((0, coupling.shape[1]))
        if modes.factor is not None:
            relaxed = cho_solve(modes.factor, coupling[modes.inner])
            system = system - coupling[modes.inner].T @ relaxed
        multipoles = -np.linalg.solve(system, gains.T)
        currents[modes.inner] -= relaxed @ multipoles
        ends = np.cumsum([len(edge.mass) for edge in edges])
        split = np.split(multipoles, ends)[: len(edges)]
        change = gains @ multipoles
        return modes.relative + 0.5 * (change + change.T), currents, edges, split

    def parameters(self, touches: Sequence[Touch] = ()) -> list[str]:
        """Parameter names that `derivatives` accepts; `[l]` counts electrodes, harmonics or
        touches."""
        g, n = self.geometry, self.electrodes.n
        names = ["conductivity_S_per_m", "thickness_mm"]
        if len(g.inner):
            return names + _inner_parameters(g) + [f"contrast[{i}]" for i in range(len(touches))]
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

        Raises InputError for touches of contrast 0, clipped ones and those held off the rim, which
        have no derivatives here; with electrodes inside, for parameters but `parameters()`.
        """
        if self.bulk:
            actual = f"{self.geometry.gradient_across:g}"
            raise InputError("skin", "gradient_across", actual, "0, to differentiate")
        for touch in touches:
            if abs(touch.contrast) <= LEAST_CONTRAST:
                raise InputError("touch", "contrast", touch.contrast, "one to differentiate by")
        if len(self.geometry.inner):
            return self._inner_derivatives(touches, parameters)
        slope = _Slopes(self, *self._solve(touches))
        names = self.parameters(touches) if parameters is None else parameters
        return {name: self.sheet_resistance * slope.derivative(name) for name in names}

    def _inner_derivatives(
        self, touches: Sequence[Touch], parameters: list[str] | None
    ) -> dict[str, np.ndarray]:
        """`derivatives` of a skin with electrodes inside."""
        known = self.parameters(touches)
        names = known if parameters is None else parameters
        for name in names:
            if name not in known:
                expected = f"one of {', '.join(known)}"
                raise InputError("skin", "derivatives beside electrodes inside", name, expected)
        for touch in touches:
            if self.electrodes.covers([(touch.x_mm, touch.y_mm, touch.radius_mm)])[0]:
                place = f"({touch.x_mm:g}, {touch.y_mm:g}) mm, over an electrode inside"
                raise InputError("touch", "derivatives", place, "a touch beside it")
        slopes = _InnerSlopes(self, *self._solve(touches))
        return {name: self.sheet_resistance * slopes.derivative(name) for name in names}


@dataclass(frozen=True)
class _InnerSlopes:
    """dR = X^T dS X of a skin with electrodes inside, dS a central difference: as _Slopes."""

    forward: Forward
    relative: np.ndarray
    currents: np.ndarray
    edges: list[TouchEdge]
    multipoles: list[np.ndarray]

    def derivative(self, parameter: str) -> np.ndarray:
        kind, _, index = parameter.rstrip("]").partition("[")
        if kind == "contrast":
            edge, amplitude = self.edges[int(index)], self.multipoles[int(index)]
            return -(amplitude.T @ edge.mass @ amplitude) / edge.touch.contrast**2
        g = self.forward.geometry
        if kind in ("electrode_x_mm", "electrode_y_mm"):
            step = SLOPE_STEP * (g.electrode_width_mm[int(index)] or 1.0)
            slope = self._difference("electrode_inside_mm", index, step, kind[10] == "y")
        elif kind == "electrode_deg":
            slope = self._difference(kind, index, np.degrees(SLOPE_STEP / g.radius_mm), False)
        else:
            value = float(np.asarray(getattr(g, kind), float)[int(index) if index else ()])
            slope = self._difference(kind, index, SLOPE_STEP * value, False)
            if not index:
                slope = slope - self.relative / value
        return slope

    def _difference(self, field: str, index: str, step: float, across: bool) -> np.ndarray:
        """(n, n): X^T dS X over twice the step; across: of the imaginary part."""
        electrodes, slope = self.forward.electrodes, np.zeros_like(self.relative)
        for sign in (1.0, -1.0):
            change = sign * step * (1j if across else 1.0)
            value = getattr(self.forward.geometry, field)
            if index:
                value = value.copy()
                value[int(index)] += change
            else:
                value = value + change
            geometry = self.forward.geometry.with_values(**{field: value})
            beside = (
                electrodes.with_contacts(geometry)
                if geometry.same_outline(self.forward.geometry)
                else electrodes.on(geometry)
            )
            power = self.currents.T @ np.nan_to_num(beside.matrix) @ self.currents
            for edge, amplitude in zip(self.edges, self.multipoles, strict=True):
                cross = self.currents.T @ (beside.coupling(edge) @ amplitude)
                power = power + cross + cross.T
            slope += sign * power / (2.0 * step)
        return slope + np.where(np.isnan(self.relative), np.nan, 0.0)


def _inner_parameters(geometry: Geometry) -> list[str]:
    """Parameters of the electrodes of a skin with some inside: places, widths and contacts."""
    names = [f"electrode_deg[{i}]" for i in geometry.on_rim]
    names += [f"electrode_{axis}_mm[{i}]" for axis in "xy" for i in geometry.inner]
    if geometry.points:
        return names
    everywhere = range(len(geometry.electrode_deg))
    kinds = ("electrode_width_mm", "contact_impedivity_ohm_m2")
    return names + [f"{kind}[{i}]" for kind in kinds for i in everywhere]


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
        self.amplitude = self.electrodes.of_pieces(currents)

    @cached_property
    def contact_blocks(self) -> np.ndarray:
        """(m, order, order): contact drop of every piece of the electrodes."""
        return self.electrodes.contact_blocks()

    def derivative(self, parameter: str) -> np.ndarray:
        kind, _, index = parameter.rstrip("]").partition("[")
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
            return self._motion_slope(None, {number: motion})
        if kind == "electrode_deg":
            return self._motion_slope(self.electrodes.angle_motion(number), {})
        if kind == "electrode_width_mm":
            return self._motion_slope(self.electrodes.width_motion(number), {})
        return self._skin_motion_slope(RimMotion(g, kind, number))

    def _contact_drop(self, electrode: int) -> np.ndarray:
        if self.geometry.points:
            return np.zeros_like(self.relative)
        selection = self.electrodes.pieces.of(electrode)
        amplitude = self.amplitude[selection]
        return np.sum(amplitude.mT @ self.contact_blocks[selection] @ amplitude, axis=0)

    def _skin_motion_slope(self, motion: RimMotion) -> np.ndarray:
        forward, g = self.forward, self.geometry
        phi = forward.disc.phi
        assert phi is not None
        velocity = g.unfold(motion.rim(phi)) + motion.unfolding(g.rim(phi))
        map_velocity = forward.disc.velocity(velocity)
        edge_motions = {i: e.skin_motion(motion, map_velocity) for i, e in enumerate(self.edges)}
        return self._motion_slope(self.electrodes.skin_motion(motion, map_velocity), edge_motions)

    def _motion_slope(
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
                source, source_motion = self.edges[j], edge_motions.get(j)
                if motion is None and source_motion is None:
                    continue
                response = edge.inner_response_slope(
                    source, amplitude, self.multipoles[j], motion, source_motion
                )
                reverse_response = source.inner_response_slope(
                    edge, self.multipoles[j], amplitude, source_motion, motion
                )
                change += 0.5 * (response + reverse_response.T)
            total += change + change.T
        return total


def separated_modes(mass: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Basis (..., 2 degree, K) of multipoles with unit mass and diagonal response, and the poles
    (..., K) on that diagonal: V^T mass V = 1, V^T response V = diag(poles).

    Multipoles without mass, by LEAST_MASS, have zero columns."""
    xp = library(mass)
    weight, vectors = xp.linalg.eigh(mass)
    has_mass = weight > LEAST_MASS * weight[..., -1:]
    scale = xp.where(has_mass, 1.0 / xp.sqrt(xp.where(has_mass, weight, 1.0)), 0.0)
    basis = vectors * scale[..., None, :]
    poles, turn = xp.linalg.eigh(basis.mT @ response @ basis)
    return basis @ turn, poles


def disc_map(geometry: Geometry) -> DiscMap:
    """The conformal map of a skin onto the unit disc: of an outline, with as many poles as bring
    its defect to FINE_DEFECT, or else the best. Raises InputError where its rim is too rough."""
    try:
        return _smooth_map(geometry) if geometry.outline is None else _poled_map(geometry)
    except ValueError as error:
        expected = "a smooth, star-shaped rim"
        if geometry.outline is not None:
            expected = "a rim with few corners or none, and no narrow tips"
        raise InputError("skin", "domain shape", str(error), expected) from None


def _smooth_map(geometry: Geometry) -> DiscMap:
    """The map of a disc, an ellipse or a rim of few harmonics; the last few are kept. Raises
    ValueError where the rim is too rough."""
    key = geometry.rim_key(), None
    mapped = _maps.get(key)
    if not isinstance(mapped, DiscMap):
        phi, _ = geometry.rim_phi()
        mapped = DiscMap(geometry.unfold(geometry.rim(phi)), phi)
        _keep(key, mapped)
    return mapped


def _keep(key: tuple, mapped: DiscMap | ValueError) -> None:
    """Keep a map, or why there is none, and forget the eldest."""
    while len(_maps) >= KEPT_MAPS:
        _maps.pop(next(iter(_maps)))
    _maps[key] = mapped


def _poled_map(geometry: Geometry) -> DiscMap:
    """The map with poles. Raises ValueError where none fits the rim."""
    best, refusal, crowding = None, None, 0.0
    assert geometry.outline is not None
    beside_curves = [BESIDE_CURVES] if geometry.outline.smooth else []
    for fineness in (*FINENESSES, *beside_curves, AT_INWARD_CORNERS):
        if fineness == AT_INWARD_CORNERS and best and best.defect < COARSE_SHARE * crowding:
            return best
        mapped = _map_at(geometry, fineness)
        if isinstance(mapped, ValueError):
            refusal = mapped
            continue
        best = mapped if best is None or mapped.defect < best.defect else best
        crowding = _least_arc(geometry, best)
        if best.defect < min(FINE_DEFECT, FINE_SHARE * crowding):
            return best
    if best is None:
        assert refusal is not None
        raise refusal
    if not best.defect < COARSE_SHARE * crowding:
        actual = f"an electrode's arc of {crowding:.1e} on the disc, known to {best.defect:.1e}"
        raise ValueError(actual)
    return best


def _map_at(geometry: Geometry, fineness: Fineness) -> DiscMap | ValueError:
    """The map with so many poles, or why there is none; the last few are kept, for skins that
    differ in their electrodes, contacts or patches alone."""
    key = geometry.rim_key(), fineness
    if key not in _maps:
        phi, corners = geometry.rim_phi(fineness.most_at_corner, fineness.even_points)
        place, slope = (geometry.unfold(geometry.rim(phi, order)) for order in (0, 1))
        length = np.abs(slope) * 0.5 * (np.roll(phi, -1) - np.roll(phi, 1)) % np.pi
        assert geometry.outline is not None
        bent = geometry.outline.is_bent(phi)
        sample = RimSample(place, -1j * slope / np.abs(slope), length, bent, corners)
        try:
            poles = placed(sample, fineness)
            if len(poles.place) > MOST_POLES:
                actual = f"it takes {len(poles.place)} poles"
                raise ValueError(f"rim too rough for a conformal map: {actual}")
            mapped = DiscMap(place, phi, poles, geometry.centre, COARSE_DEFECT)
            _keep(key, _checked(mapped, geometry))
        except ValueError as error:
            _keep(key, error)
    return _maps[key]


def _checked(mapped: DiscMap, geometry: Geometry) -> DiscMap:
    """The map unchanged. Raises ValueError where it is one on its points of the rim alone."""
    phi = mapped.phi
    assert phi is not None
    middle = phi + 0.5 * ((np.roll(phi, -1) - phi) % (2.0 * np.pi))
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.abs(mapped(geometry.unfold(geometry.rim(middle))))
    between = float(np.abs(size - 1.0).max())
    if not between <= BETWEEN_SHARE * max(mapped.defect, ROUNDING_DEFECT):
        actual = f"| |f| - 1 | = {between:.1e} between its points"
        raise ValueError(f"rim too rough for a conformal map: {actual}")
    return mapped


def _least_arc(geometry: Geometry, disc: DiscMap) -> float:
    """Of all electrodes, the least angle that spans one on the disc, rad; of points, 1 mm."""
    place = geometry.unfold(geometry.electrode_place)
    width = 1.0 if geometry.points else geometry.electrode_width_mm
    arcs = np.abs(disc.derivatives(place, 1)[1]) * width
    if not geometry.has_rim:
        return float(arcs.min())
    inner_arcs, arcs = arcs[geometry.inner], arcs[geometry.on_rim]
    geometry = geometry.rim_part
    middle, split = np.radians(geometry.electrode_deg), pieces(geometry)
    round_corner = np.flatnonzero(np.bincount(split.electrode) > 1)
    if len(round_corner):
        half = geometry.electrode_width_mm[round_corner] / (2.0 * geometry.radius_mm)
        ends = middle[round_corner] + np.multiply.outer([1.0, -1.0], half)
        stop, start = disc(geometry.unfold(geometry.rim(ends)))
        arcs[round_corner] = np.angle(stop / start) % (2.0 * np.pi)
    return float(min(arcs.min(), inner_arcs.min(initial=np.inf)))


def _clearances(touches: list[Touch]) -> list[float]:
    """Distance from each touch to the nearest other edge, in its radii. Raises InputError on
    overlap."""
    clearances = []
    for a in touches:
        gaps = [
            np.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm) - a.radius_mm - b.radius_mm
            for b in touches
            if b is not a
        ]
        if gaps and min(gaps) <= 0:
            actual = f"two that overlap by {-min(gaps):g} mm"
            raise InputError("touch", "touches", actual, "touches apart")
        clearances.append(min(gaps, default=np.inf) / a.radius_mm)
    return clearances
