"""The third dimension: a disc as a body with electrodes that do not reach through its depth.

The complete electrode model in a circular cylinder, bottom and top insulated: sigma du/dn =
(U_l - u) / z_l on electrode l's rectangle of the rim, no current elsewhere. The unknown is each
electrode's current density alone, in Legendre modes across times Legendre modes up. The rim's
Neumann function is, with k_m = m pi / depth and lengths over the radius,

  (1 / 2 pi) sum_m e_m cos(k_m z) cos(k_m z') sum_n exp(i n (phi - phi')) q_n(k_m),
  q_n(k) = I_n(k) / (k I_n'(k)), q_n(0) = 1 / |n|, e_0 = 1, e_m = 2,

per unit sheet resistance 1 / (sigma depth); m = 0 is the sheet. Its slow part, the 1 / r of a flat
half-space, is split after Ewald (1921): erfc(eta r) / (2 pi r) within each electrode and to its
images in bottom and top, by quadrature; what is left of the double series falls off at once.

Electrodes meet one another's smooth fields alone, whose Legendre coefficients fall geometrically
with the order. So only the lowest modes, the coupled ones, are unknowns of the whole body; the
others of an electrode take least power for these, one electrode at a time (static condensation,
Guyan 1965).
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.special import erf, erfc, spherical_jn

from eitskin.errors import InputError
from eitskin.physics.bessel_ratios import cylinder_response
from eitskin.physics.column_touch import ColumnTouch
from eitskin.physics.electrodes import Electrodes, OnRim
from eitskin.physics.forward import Accuracy, Forward, contacts_too_good
from eitskin.physics.geometry import Geometry
from eitskin.physics.touch import PanelSizes, Touch, TouchEdge, graded_panels
from eitskin.physics.touch_cache import ContactCoupling, Place, TouchCoupling

MOST_TERMS = 10_000_000  # of the double series: 80 MB an array
LADDER = 1.1  # of lengths that the expansion follows in steps: bodies that differ little share it
SHARED_SERIES, SHARED_HALVES = 4, 64  # kept, of a few megabytes each; with good contacts of eight
WORST_COUPLING = 5.0  # error of a body's voltages where only the whole currents were coupled
SHEET_OPERATIONS = 1e8  # of a body, in the time that solves a sheet of a known outline
LEAST_OPERATIONS, EXPANSION_OPERATIONS = 1e8, 1e8  # of the smallest body, of its expansion
SHEET_ELEMENTS = 2.5e6  # of a body's matrix that a touched place reads in that time


class Quadrature(NamedTuple):
    """Of the near half: nodes of a panel, and the shortest panel over an electrode's half side, of
    which an integrable 1 / r leaves less out."""

    nodes: int
    shortest: float

    def panels(
        self, start: float, stop: float, zero: float, rate: float, clearance: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and weights on [start, stop] for erfc(rate lag) / |lag - zero|, where the distance
        is at least `clearance`."""
        return graded_panels(
            start,
            stop,
            lambda lag: 0.45 * np.hypot(lag - zero, clearance),
            PanelSizes(min(1.0, 1.5 / rate), self.shortest, self.nodes),
        )


@dataclass(frozen=True)
class DepthAccuracy:
    """Modes up an electrode, and where the two halves of Ewald's split end.

    height_order: modes where the contact length z sigma is CONTACT_KNEE of the height or more; a
    better contact crowds the current at the edges and gets sqrt(CONTACT_KNEE height / (z sigma))
    times as many, up to most_modes.
    coupled_tolerance: error of the voltages that coupled modes leave; of these there are no more
    than of a sheet's electrode_order across and height_order up.
    split: the near half ends at eta r = split, the series at rho = 2 eta split or later.
    cut: the series continues to rho = cut over the smaller of half width and half height.
    touch_tolerance: share of a touch's signal, below which a multipole in depth is left out.

    Measured on 14 random bodies with 16 electrodes against 18 x 18 modes: voltages away from the
    drive to 2e-3 ("train") and 1e-5 ("diagnose") of the median one, in the median to 1e-5 and 3e-7.
    A touch's change, 5 to 18 mm off the rim, against boundary integrals: to 2e-3 and 1e-4 of it;
    beside electrodes wider than the touch is off the rim, coupled modes add as much once more.
    """

    height_order: int
    split: float
    cut: float
    most_modes: int
    touch_tolerance: float
    coupled_tolerance: float
    quadrature: Quadrature

    def modes(self, geometry: Geometry, heights: "Span") -> int:
        """Modes up an electrode, as its contact asks for."""
        contact = float(geometry.contact_length_mm.min()) / heights.height_mm
        modes = self.height_order * max(1.0, np.sqrt(CONTACT_KNEE / contact))
        return min(int(np.ceil(modes)), self.most_modes)

    def coupled(self, decay: float, most: int) -> int:
        """Coupled modes in one direction, at most `most`, where the Legendre coefficients of the
        field fall by `decay` with each order; odd, as fields may be even across an electrode."""
        digits = np.log(WORST_COUPLING / self.coupled_tolerance)
        order = np.ceil(0.5 * digits / np.log(decay)) if decay > 1.0 else most
        return min(int(order) | 1, most)

    def most_coupled(self, sheet: Accuracy) -> tuple[int, int]:
        """Coupled modes of an electrode, across and up, of which there are no more; sheet: its
        accuracy across."""
        return sheet.electrode_order | 1, self.height_order | 1

    def most_bytes(self, geometry: Geometry, sheet: Accuracy) -> int:
        """Bytes of the matrices of a body's modes, at most."""
        heights, n = span(geometry), len(geometry.electrode_deg)
        assert heights is not None
        across, up = sheet.modes(geometry), self.modes(geometry, heights)
        most_across, most_up = self.most_coupled(sheet)
        coupled = n * min(across, most_across) * min(up, most_up)
        return 8 * (n * (across * up) ** 2 + coupled**2)


CONTACT_KNEE = 0.15  # z sigma / height at which the layer at an edge asks for more modes
DEPTH_ACCURACIES = {
    "train": DepthAccuracy(4, 3.5, 8.0, 8, 2e-4, 1e-5, Quadrature(6, 1e-5)),
    "diagnose": DepthAccuracy(8, 4.0, 20.0, 16, 1e-5, 1e-7, Quadrature(10, 1e-6)),
}


@dataclass(frozen=True)
class Span:
    """The height of all electrodes, and of their centre above the bottom, in mm."""

    height_mm: float
    z_mm: float


def span(geometry: Geometry) -> Span | None:
    """The Span of a deep geometry; None for a sheet or electrodes of full height."""
    if not geometry.deep or geometry.electrode_height_mm is None:
        return None
    z = geometry.electrode_z_mm
    return Span(geometry.electrode_height_mm, 0.5 * geometry.thickness_mm if z is None else z)


def legendre_overlap(order: int, lag: np.ndarray) -> np.ndarray:
    """(order, order, lags): int P_i(t) P_j(t - lag) / 4 dt over the overlap, lag in [-2, 2]."""
    node, weight = np.polynomial.legendre.leggauss(order)
    half = 1.0 - 0.5 * np.abs(lag)[:, None]
    t = 0.5 * lag[:, None] + half * node
    legendre = np.polynomial.legendre.legvander(t, order - 1)
    lagged_legendre = np.polynomial.legendre.legvander(t - lag[:, None], order - 1)
    return 0.25 * np.einsum(
        "sqi,sqj,sq->ijs", legendre, lagged_legendre, half * weight, optimize=True
    )


class Expansion(NamedTuple):
    """Ewald's split of a body's Neumann function between modes up an electrode, lengths in radii.

    up: modes up; depth, half_height, z: of the body, of an electrode, and of its centre above the
    bottom; reach: where the near half ends; eta: its rate; n_max, m_max: the last angular order and
    depth mode of the series.
    """

    up: int
    depth: float
    half_height: float
    z: float
    reach: float
    eta: float
    n_max: int
    m_max: int
    quadrature: Quadrature

    def wave(self, k: np.ndarray) -> np.ndarray:
        """(up, K): projection of cos(k z), k (K,), on the modes up."""
        degree = np.arange(self.up)[:, None]
        bessel = spherical_jn(degree, k * self.half_height)
        return (np.exp(1j * k * self.z) * 1j**degree * bessel).real


@lru_cache(SHARED_SERIES)
def slow_series(expansion: Expansion) -> np.ndarray:
    """(n_max + 1, up, up): sum over the depth modes for every angular order, without the near
    half."""
    k = np.pi / expansion.depth * np.arange(expansion.m_max + 1)
    n = np.arange(expansion.n_max + 1)[:, None]
    rho = np.hypot(n, k)
    rho[0, 0] = 1.0
    kernel = cylinder_response(expansion.n_max, k)
    kernel -= erf(rho / (2.0 * expansion.eta)) / rho
    kernel[0, 0] = -1.0 / (np.sqrt(np.pi) * expansion.eta)
    wave = expansion.wave(k)
    pairs = np.einsum("im,jm->mij", wave, wave) * np.where(k > 0, 2.0, 1.0)[:, None, None]
    series = (kernel @ pairs.reshape(len(k), -1)).reshape(-1, expansion.up, expansion.up)
    series.flags.writeable = False
    return series


@lru_cache(SHARED_HALVES)
def near_half(expansion: Expansion, across: int, half_width: float) -> np.ndarray:
    """(across, up, across, up): the near half within an electrode of a half width in radii, and to
    its images in bottom and top."""
    total = np.zeros((across, expansion.up, across, expansion.up))
    reach, depth, height = expansion.reach, expansion.depth, 2.0 * expansion.half_height
    images = int(np.ceil((reach + height) / (2.0 * depth))) + 1
    for fold in range(-images, images + 1):
        for place, mirrored in ((0.0, False), (2.0 * expansion.z, True)):
            offset = place + 2.0 * depth * fold
            if abs(offset) - height < reach:
                total += _image_part(expansion, across, half_width, offset, mirrored)
    total *= depth / (2.0 * np.pi)
    total.flags.writeable = False
    return total


def _image_part(
    expansion: Expansion, across: int, half_width: float, offset: float, mirrored: bool
) -> np.ndarray:
    """One image's contribution: mode pairs integrated over erfc(eta r) / r in the lags across and
    up, in panels that shrink towards r = 0."""
    height_gap = max(abs(offset) - 2.0 * expansion.half_height, 0.0)
    lag, weight, above = _lags_up(expansion, offset, height_gap, mirrored)
    widest = LADDER * _rung_below(half_width)
    lag_across, across_weight, overlap = _lags_across(
        expansion.quadrature, across, expansion.eta * widest, height_gap / widest
    )
    r = np.hypot(half_width * lag_across[:, None], offset + expansion.half_height * lag)
    kernel = across_weight[:, None] * erfc(expansion.eta * r) / r * weight
    return np.einsum("act,ts,bds->abcd", overlap, kernel, above, optimize=True)


@lru_cache(SHARED_HALVES)
def _lags_up(
    expansion: Expansion, offset: float, height_gap: float, mirrored: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lags up (S,) and weights of an image, and the overlap (up, up, S) of the modes at them."""
    half_height = expansion.half_height
    touching = np.clip(-offset / half_height, -2.0, 2.0)
    rate, clearance = expansion.eta * half_height, height_gap / half_height
    panel_ends = np.unique([-2.0, 0.0, touching, 2.0])
    panels = [
        expansion.quadrature.panels(a, b, touching, rate, clearance)
        for a, b in pairwise(panel_ends)
    ]
    lag, weight = (np.concatenate(part) for part in zip(*panels, strict=True))
    above = legendre_overlap(expansion.up, lag)
    if mirrored:
        above = above * (-1.0) ** np.arange(expansion.up)[:, None]
    return lag, weight, above


@lru_cache(SHARED_HALVES)
def _lags_across(
    quadrature: Quadrature, across: int, rate: float, clearance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lags across (T,) and weights, and the overlap (across, across, T) of the modes at them, in
    both directions."""
    lag, weight = quadrature.panels(0.0, 2.0, 0.0, rate, clearance)
    overlap = legendre_overlap(across, lag)
    return lag, weight, overlap + overlap.transpose(1, 0, 2)


def _rung_below(length: float) -> float:
    """The power of LADDER that is no more than a length."""
    return float(LADDER ** np.floor(np.log(length) / np.log(LADDER)))


class Interaction(NamedTuple):
    """Power of the modes' currents in a body, contacts aside.

    within (W, F, F): of all modes of one electrode, of each width that there is; between (n C, n
    C): of the coupled modes of different electrodes, 0 within one.
    """

    within: np.ndarray
    between: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of the matrices."""
        return self.within.nbytes + self.between.nbytes


class BodyElectrodes(OnRim):
    """Electrodes of partial height, with the interface of Electrodes; order = across * up coupled
    modes each.

    `across` counts coupled modes across, the first of an electrode's modes is its whole current,
    and the next ones go up. Raises InputError for a body that is not circular and for electrodes
    off it.
    """

    def __init__(
        self, sheet: Electrodes, heights: Span, accuracy: DepthAccuracy, most: tuple[int, int]
    ):
        """most: coupled modes across and up, of which there are no more."""
        self.sheet, self.heights = sheet, heights
        g = self.geometry = sheet.geometry
        _check(g, heights)
        self.n, self.all_up = sheet.n, accuracy.modes(g, heights)
        self._choose_orders(accuracy, *most)
        self.order = self.across * self.up
        self.size = self.n * self.order
        self.whole = np.arange(self.n) * self.order
        self.rim = sheet.rim
        self._place()
        self.interaction = self._interaction()

    @property
    def modes(self) -> int:
        """Modes of an electrode, coupled or not."""
        return self.sheet.order * self.all_up

    @property
    def matrix(self) -> np.ndarray:
        """(size, size): power of the coupled modes' currents, the others relaxed. Computed on every
        call. Raises InputError for contacts too good to be resolved."""
        matrix = self.interaction.between.copy()
        blocks = matrix.reshape(self.n, self.order, self.n, self.order)
        blocks[range(self.n), :, range(self.n)] = self._condensed()
        return matrix

    def _condensed(self) -> np.ndarray:
        """(n, order, order): power of each electrode's coupled modes within it, with its contact's
        sigma depth z_l int (P_i P_j)^2 / 16 / (dA/dt ds) over the face."""
        contacts = np.column_stack([self.sheet.half_width, self.geometry.contact_length_mm])
        _, sample, kind = np.unique(contacts, axis=0, return_index=True, return_inverse=True)
        across = self.sheet.contact_blocks()[sample]
        share = self.geometry.thickness_mm / self.heights.height_mm
        up = np.diag(share / (2.0 * np.arange(self.all_up) + 1.0))
        drop = (across[:, :, None, :, None] * up[:, None]).reshape(-1, self.modes, self.modes)
        power = self.interaction.within[self.of_width[sample]] + drop
        number = np.arange(self.modes).reshape(self.sheet.order, self.all_up)
        coupled = number[: self.across, : self.up].ravel()
        inner = np.setdiff1d(number, coupled)
        try:
            factor = np.linalg.cholesky(power[:, inner[:, None], inner])
        except np.linalg.LinAlgError:
            raise contacts_too_good(self.geometry) from None
        root = np.linalg.solve(factor, power[:, inner[:, None], coupled])
        condensed = power[:, coupled[:, None], coupled] - root.mT @ root
        return condensed[kind.ravel()]

    def on_body(self, sheet: Electrodes, heights: Span) -> "BodyElectrodes":
        """The same expansion on a slightly different body. Parts that agree are shared, and
        differences of matrices contain no change of the expansion."""
        body = copy.copy(self)
        body.sheet, body.geometry, body.heights = sheet, sheet.geometry, heights
        if not body.same_interaction(self.geometry, self.heights):
            body._place()
            body.interaction = body._interaction()
        return body

    def same_interaction(self, geometry: Geometry, heights: Span) -> bool:
        """Whether a body's modes have the same interaction, contacts aside, as here."""
        return (
            self.heights == heights
            and self.geometry.same_outline(geometry)
            and self.geometry.thickness_mm == geometry.thickness_mm
        )

    def _place(self) -> None:
        """Set the expansion, and the modes' Fourier coefficients where it has the electrodes:
        widths (W,): the half widths that there are, of_width (n,): which an electrode has,
        at_centre: `_at_centre`."""
        g = self.geometry
        self.expansion = Expansion(
            self.all_up,
            g.thickness_mm / g.radius_mm,
            self.heights.height_mm / (2.0 * g.radius_mm),
            self.heights.z_mm / g.radius_mm,
            self.reach,
            self.eta,
            self.n_max,
            self.m_max,
            self.quadrature,
        )
        self.depth = self.expansion.depth
        self.widths, self.of_width = np.unique(self.sheet.half_width, return_inverse=True)
        self.at_centre = self._at_centre()
        self.angular = self._angular()

    def _choose_orders(self, accuracy: DepthAccuracy, most_across: int, most_up: int) -> None:
        """Choose the coupled modes, the range of the near half and the length of the series."""
        g, half = self.geometry, self.sheet.half_width
        phi = np.radians(g.electrode_deg) % (2.0 * np.pi)
        turn = np.argsort(phi)
        spacing = np.diff(np.append(phi[turn], phi[turn[0]] + 2.0 * np.pi))
        gap = (spacing - half[turn] - np.roll(half[turn], -1)).min()
        widest, half_height = half.max(), self.heights.height_mm / (2.0 * g.radius_mm)
        aside, above = max(gap, 0.0) / widest, max(gap, 0.0) / half_height
        # The nearest other electrode lies beyond an end of t = -1 to 1 across, beside it going up.
        decay_across = 1.0 + aside + np.sqrt(aside * (aside + 2.0))
        decay_up = above + np.hypot(above, 1.0)
        self.across = min(accuracy.coupled(decay_across, most_across), self.sheet.order)
        self.up = min(accuracy.coupled(decay_up, most_up), self.all_up)
        depth = g.thickness_mm / g.radius_mm
        self.reach = _rung_below(min(gap, 4.0 * depth, 1.0))
        self.eta = accuracy.split / self.reach
        smallest = min(half.min(), half_height)
        end = max(2.0 * accuracy.split * self.eta, accuracy.cut / _rung_below(smallest))
        self.n_max, self.m_max = int(np.ceil(end)), int(np.ceil(end * depth / np.pi))
        self.quadrature = accuracy.quadrature
        if self.n_max * self.m_max > MOST_TERMS:
            actual = f"{gap:.1e} apart, {smallest:.1e} half a side, in radii"
            expected = f"larger ones further apart, for {MOST_TERMS:.0e} terms of a series"
            raise InputError("skin", "electrodes", actual, expected)

    def wave(self, k: np.ndarray) -> np.ndarray:
        """(up, K): projection of cos(k z), k (K,), on the coupled modes up."""
        return self.expansion.wave(k)[: self.up]

    def distance(self, place: complex) -> float:
        """Distance from a place in the unit disc to the nearest electrode."""
        half, phi = self.sheet.half_width, np.radians(self.geometry.electrode_deg)
        turn = np.angle(place * np.exp(-1j * phi))
        nearest = np.exp(1j * (phi + np.clip(turn, -half, half)))
        return float(np.abs(nearest - place).min())

    def _at_centre(self) -> np.ndarray:
        """(W, modes across, n_max + 1): Fourier coefficients of the modes across an electrode of
        each width at the angle 0, weighted by the root of the series' 1 / pi (1 / 2 pi for n =
        0)."""
        n = np.arange(self.n_max + 1)
        degree = np.arange(self.sheet.order)[:, None]
        bessel = spherical_jn(degree, n * self.widths[:, None, None])
        wave = 1j**degree * bessel / np.sqrt(np.pi)
        wave[:, :, 0] /= np.sqrt(2.0)
        return wave

    def _angular(self) -> np.ndarray:
        """(n across, 2 (n_max + 1)): Fourier coefficients of the coupled modes across, real and
        imaginary, weighted as `_at_centre`'s."""
        phi = np.radians(self.geometry.electrode_deg)[:, None, None]
        turn = np.exp(1j * np.arange(self.n_max + 1) * phi)
        wave = turn * self.at_centre[self.of_width, : self.across]
        return np.concatenate([wave.real, wave.imag], axis=2).reshape(self.n * self.across, -1)

    def _interaction(self) -> Interaction:
        """The interaction of the electrodes' modes where they are."""
        series = slow_series(self.expansion)
        order, up = self.sheet.order, self.all_up
        products = (self.at_centre[:, :, None].conj() * self.at_centre[:, None]).real
        within = products.reshape(-1, len(series)) @ series.reshape(len(series), -1)
        within = within.reshape(-1, order, order, up, up).transpose(0, 1, 3, 2, 4)
        within = within + np.array([near_half(self.expansion, order, w) for w in self.widths])
        shape = (self.n, self.across, self.up, self.n, self.across, self.up)
        between = np.empty(shape)
        for i in range(self.up):
            for j in range(i + 1):
                block = (self.angular * np.tile(series[:, i, j], 2)) @ self.angular.T
                between[:, :, i, :, :, j] = block.reshape(self.n, self.across, self.n, self.across)
                between[:, :, j, :, :, i] = between[:, :, i, :, :, j]
        between[range(self.n), :, :, range(self.n)] = 0.0
        return Interaction(
            within.reshape(-1, self.modes, self.modes), between.reshape(self.size, self.size)
        )

    def project(self, potential: np.ndarray) -> np.ndarray:
        """(n order, k): projection on the coupled modes of potentials at the sheet's nodes that are
        the same at every height."""
        across = self.sheet.project(potential).reshape(self.n, self.sheet.order, -1)
        modes = np.zeros((self.n, self.across, self.up, across.shape[2]))
        modes[:, :, 0] = across[:, : self.across]
        return modes.reshape(self.size, -1)


def _check(geometry: Geometry, heights: Span) -> None:
    g, low = geometry, heights.z_mm - 0.5 * heights.height_mm
    if g.points:
        raise InputError(
            "skin", "electrode_width_mm", 0, "more than 0 for electrodes with a height"
        )
    straight = g.stretch_x == g.stretch_y == g.anisotropy_ratio == 1.0
    if not straight or any(g.shape_cos.values()) or any(g.shape_sin.values()):
        raise InputError("skin", "domain shape", "no circle", "a circular rim, for a body")
    if g.gradient_across:
        raise InputError("skin", "gradient_across", g.gradient_across, "0, for a body")
    if not heights.height_mm > 0:
        raise InputError("skin", "electrode_height_mm", heights.height_mm, "more than 0")
    room = 1e-9 * g.thickness_mm
    if low < -room or low + heights.height_mm > g.thickness_mm + room:
        actual = f"{low:g} to {low + heights.height_mm:g} mm"
        expected = f"electrodes within 0 to {g.thickness_mm:g} mm"
        raise InputError("skin", "electrode_z_mm", actual, expected)


class DepthForward(Forward):
    """A body `thickness_mm` deep with electrodes over a part of its height: a tank, a thick skin.

    Otherwise like Forward; with heights None it is a Forward. A touch reaches through the whole
    depth; one that the rim clips couples to the mean over the depth alone.
    """

    def __init__(
        self,
        geometry: Geometry,
        heights: Span | None,
        accuracy: str | Accuracy = "diagnose",
        depth_accuracy: str | DepthAccuracy | None = None,
        donor: Forward | None = None,
        lends_parts: bool = False,
    ):
        """`depth_accuracy`: a name of DEPTH_ACCURACIES or a DepthAccuracy, by default the name
        `accuracy`; `donor`: a solved skin, to share parts with; `lends_parts`: as for Forward."""
        self._place(geometry, accuracy)
        depth_choice = accuracy if depth_accuracy is None else depth_accuracy
        self.depth_accuracy = (
            DEPTH_ACCURACIES[depth_choice] if isinstance(depth_choice, str) else depth_choice
        )
        self.heights = heights
        if heights is not None:
            self._expand(donor)
        if not lends_parts:
            self.unit_currents()

    def _expand(self, donor: Forward | None) -> None:
        """Set the electrodes and the efforts of a body."""
        sheet, heights, accuracy = self.electrodes, self.heights, self.depth_accuracy
        assert heights is not None and isinstance(accuracy, DepthAccuracy)
        shared = (
            isinstance(donor, DepthForward)
            and donor.heights is not None
            and donor.depth_accuracy == accuracy
            and donor.electrodes.same_interaction(self.geometry, heights)
            and donor.electrodes.sheet.order == sheet.order
            and donor.electrodes.all_up == accuracy.modes(self.geometry, heights)
        )
        if shared:
            assert isinstance(donor, DepthForward)
            self.electrodes = donor.electrodes.on_body(sheet, heights)
        else:
            most = accuracy.most_coupled(self.accuracy)
            self.electrodes = BodyElectrodes(sheet, heights, accuracy, most)
        modes, unknowns = self.electrodes, self.electrodes.size
        operations = LEAST_OPERATIONS + (unknowns**3 + sheet.n * modes.modes**3) / 3.0
        if not shared:
            pairs = 0.5 * modes.up * (modes.up + 1)
            operations += EXPANSION_OPERATIONS
            operations += 4.0 * pairs * (sheet.n * modes.across) ** 2 * modes.n_max
            operations += 2.0 * modes.modes**2 * modes.n_max
        self.effort = operations / SHEET_OPERATIONS
        self.touch_effort = type(self).touch_effort + unknowns**2 / SHEET_ELEMENTS

    @property
    def nbytes(self) -> int:
        """Bytes of the modes' factor and, for a body, of their interaction."""
        interaction_bytes = 0 if self.heights is None else self.electrodes.interaction.nbytes
        return super().nbytes + interaction_bytes

    def matches(self, geometry: Geometry, accuracy: Accuracy, modes: int) -> bool:
        """As for Forward; a body shares nothing with a sheet."""
        return self.heights is None and super().matches(geometry, accuracy, modes)

    def edge(  # type: ignore[override]  # what it makes of touches only it meets again
        self, touch: Touch, touch_clearance: float = np.inf
    ) -> TouchEdge | ColumnTouch:
        """The touch, as for Forward, with its multipoles in depth."""
        edge = super().edge(touch, touch_clearance)
        if self.heights is None:
            return edge
        assert isinstance(self.depth_accuracy, DepthAccuracy)
        coupling = super()._to_electrodes(edge)
        return ColumnTouch(edge, coupling, self, self.depth_accuracy.touch_tolerance)

    def _even_couplings(self, places: list[Place]) -> dict[Place, TouchCoupling]:
        """As for Forward; empty for a body, whose touches have multipoles in depth."""
        return super()._even_couplings(places) if self.heights is None else {}

    def _to_electrodes(self, edge: TouchEdge | ColumnTouch) -> np.ndarray:
        return edge.coupling if isinstance(edge, ColumnTouch) else super()._to_electrodes(edge)

    def _mutual_response(
        self, a: TouchEdge | ColumnTouch, b: TouchEdge | ColumnTouch
    ) -> np.ndarray:
        if isinstance(a, ColumnTouch):
            assert isinstance(b, ColumnTouch)
            return block_diag(super()._mutual_response(a.edge, b.edge), a.response_to(b))
        assert isinstance(b, TouchEdge)
        return super()._mutual_response(a, b)

    def _even_current(self, edge: TouchEdge | ColumnTouch) -> ContactCoupling:
        """As for Forward; a current that is even over the depth drives no multipole in depth."""
        if not isinstance(edge, ColumnTouch):
            return super()._even_current(edge)
        mean = super()._even_current(edge.edge)
        depth_multipoles = np.zeros(len(edge.mass) - len(mean.to_touch))
        return replace(mean, to_touch=np.append(mean.to_touch, depth_multipoles))

    def parameters(self, touches: Sequence[Touch] = ()) -> list[str]:
        """Parameter names that `derivatives` accepts; a body's `thickness_mm` is its depth."""
        if self.heights is None:
            return super().parameters(touches)
        names = ["conductivity_S_per_m", "thickness_mm", "electrode_height_mm", "electrode_z_mm"]
        per_electrode = ("electrode_deg", "electrode_width_mm", "contact_impedivity_ohm_m2")
        return names + [f"{name}[{i}]" for name in per_electrode for i in range(self.electrodes.n)]

    def derivatives(
        self, touches: Sequence[Touch] = (), parameters: list[str] | None = None
    ) -> dict[str, np.ndarray]:
        """d impedance / d parameter, (n, n) ohm per unit, by name; all `parameters()` by default.

        X^T dS X with the currents X of this body and dS a central difference of the power's
        matrix. Where an electrode meets bottom or top, the power is not
        differentiable by its height and place, and those values are meaningless. Raises InputError
        for a touched body, for which derivatives are not implemented.
        """
        if self.heights is None:
            return super().derivatives(touches, parameters)
        if len(touches):
            raise InputError("touch", "derivatives", "a touched body", "an untouched one")
        names = self.parameters() if parameters is None else parameters
        return {name: self._slope(name) for name in names}

    def _slope(self, name: str) -> np.ndarray:
        assert self.heights is not None
        kind, _, index = name.rstrip("]").partition("[")
        g, relative, currents = self.geometry, *self._solve([])[:2]
        values = {**vars(g), "electrode_height_mm": self.heights.height_mm}
        values["electrode_z_mm"] = self.heights.z_mm
        value: Any = np.asarray(values[kind], float)[int(index) if index else ()]
        step = self._step(kind, value)
        above, below = (
            self._electrodes_with(kind, index, value + s * step).matrix for s in (1.0, -1.0)
        )
        slope = currents.T @ (above - below) @ currents / (2.0 * step)
        if kind in ("conductivity_S_per_m", "thickness_mm"):
            slope = slope - relative / value
        return self.sheet_resistance * 0.5 * (slope + slope.T)

    def _step(self, kind: str, value: float) -> float:
        """Half the width of the central difference."""
        if kind == "electrode_deg":
            return 0.02
        assert self.heights is not None
        return 1e-3 * (self.heights.height_mm if kind == "electrode_z_mm" else value)

    def _electrodes_with(self, kind: str, index: str, value: float) -> BodyElectrodes:
        sheet, heights = self.electrodes.sheet, self.heights
        assert heights is not None
        if kind == "electrode_height_mm":
            return self.electrodes.on_body(sheet, replace(heights, height_mm=value))
        if kind == "electrode_z_mm":
            return self.electrodes.on_body(sheet, replace(heights, z_mm=value))
        if index:
            electrode_values = getattr(self.geometry, kind).copy()
            electrode_values[int(index)] = value
            value = electrode_values
        geometry = self.geometry.with_values(**{kind: value})
        if geometry.same_outline(self.geometry):
            return self.electrodes.on_body(sheet.with_contacts(geometry), heights)
        return self.electrodes.on_body(Electrodes(geometry, self.disc, sheet.order), heights)
