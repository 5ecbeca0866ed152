"""The readings of an instrument on a skin with laws."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from eitskin.physics.skin import Skin
from witness import laws as catalogue
from witness.boundary import Disc, Radial, Resolution
from witness.curves import Shape
from witness.deep import Depth
from witness.generators import GENERATORS, AnyBody, Drawing
from witness.outlines import Outline
from witness.outside import Outside, Touches
from witness.press import Press
from witness.slab import Solid

LEAST_CONDUCTIVITY = 1e-3  # of the background's, inside a touch: contrast is kept above -1
# Chebyshev nodes between a frame's least and largest force, -1 to 1, where its skin is solved.
SKEW_NODES = np.cos(np.pi * (2 * np.arange(9) + 1) / 18)
T = TypeVar("T")
Asking = Callable[[Press, float], float]  # a quantity of a press at a time, s


class World:
    """A skin with its true values and a solver; the latest solved bodies are cached.

    channels (M, 4); frame_s: a frame's duration; sink_grounded: whether the source's sink is tied
    to ground; resolution: the boundary's; generator: the solver, of `generators.GENERATORS`;
    outline: of a skin that is no disc, whose radius is then its length over 2 pi.
    """

    def __init__(
        self,
        skin: Skin,
        channels: np.ndarray,
        frame_s: float,
        sink_grounded: bool = False,
        resolution: Resolution | None = None,
        generator: str = "boundary",
        outline: Outline | None = None,
    ):
        self.generator = GENERATORS[generator]
        self.skin, self.channels, self.frame_s = skin, channels, frame_s
        self.sink_grounded, self.resolution = sink_grounded, resolution or Resolution()
        self.outline = outline
        self._bodies: OrderedDict = OrderedDict()
        self.drives, self.drive = np.unique(channels[:, :2], axis=0, return_inverse=True)

    def readings(
        self,
        states: pd.DataFrame,
        laws: list[dict],
        outside: Outside | None = None,
        force_max_N: float | None = None,
    ) -> np.ndarray:
        """(N, M) V, noise-free, of states as the recording format has them, with `contact`.

        force_max_N: the recording's largest force where the states are a query's. Raises
        ValueError where an inclusion leaves the skin.
        """
        outside = outside or Outside()
        time = states["time_s"].to_numpy(float)
        touched = states["touch"].to_numpy(bool)
        press = np.where(touched, states["contact"].fillna(-1).to_numpy(int), -1)
        reported = states["force_N"].to_numpy(float)
        largest = float(reported.max()) if force_max_N is None else force_max_N
        offset, lag = catalogue.force_change(laws)
        history = {
            label: Press.from_reports(time[press == label], reported[press == label], offset, lag)
            for label in np.unique(press[touched])
        }

        def along(value: Asking) -> np.ndarray:
            press_and_time = zip(press, time, strict=True)
            return np.array([value(history[p], t) if p >= 0 else 0.0 for p, t in press_and_time])

        force = along(Press.force)
        peak = along(Press.peak)
        shift = catalogue.skew_fraction(laws) * catalogue.steps(force, press)
        zeta = np.arange(len(self.channels)) / (len(self.channels) - 1.0)
        channel_force = np.maximum(force[:, None] + shift[:, None] * (zeta - 0.5), 0.0)
        middle = 0.5 * (channel_force[:, -1] + channel_force[:, 0])
        half = 0.5 * np.abs(channel_force[:, -1] - channel_force[:, 0])
        nodes = SKEW_NODES if half.any() else np.zeros(1)
        current = self.skin.current_A
        volts, sinks = [], []
        for node in nodes:
            frame_force = middle + node * half
            rows = self._touches(
                states, laws, frame_force, np.maximum(peak, frame_force), along, press
            )
            outside.touch(rows, self)
            admittance = self._solve(rows, laws)
            admittance = outside.network(admittance, rows, self)
            potential = catalogue.potentials(
                laws, admittance, rows.siemens > 0, self.drives, self.sink_grounded
            )
            potential = outside.board(potential, rows, self)
            channel_index = np.arange(len(self.channels))
            potential = potential[:, self.drive]
            sink, plus, minus = (
                potential[:, channel_index, self.channels[:, k]] for k in (1, 2, 3)
            )
            volt = outside.pairs(plus - minus, admittance, rows, self)
            volts.append(current * volt)
            sinks.append(current * (0.5 * (plus + minus) - sink))
        force_position = (channel_force - middle[:, None]) / np.where(half > 0, half, 1.0)[:, None]
        volt, above_sink = (
            _interpolated(np.array(v), nodes, force_position) for v in (volts, sinks)
        )
        readout = catalogue.Readout(channel_force, time, self.channels, self.frame_s, largest)
        volt = catalogue.instrument(laws, volt, above_sink, readout)
        return outside.converted(volt, rows, self)

    def _touches(
        self,
        states: pd.DataFrame,
        laws: list[dict],
        force: np.ndarray,
        peak: np.ndarray,
        along: Callable[[Asking], np.ndarray],
        press: np.ndarray,
    ) -> Touches:
        skin = self.skin
        assert skin.radius_mm is not None and skin.conductivity_S_per_m is not None
        touched = states["touch"].to_numpy(bool)
        place = states["x_mm"].to_numpy(float) + 1j * states["y_mm"].to_numpy(float)
        place = catalogue.true_place(laws, np.where(touched, place, 0.0))
        contact_force = catalogue.felt_force(
            laws, force, lambda tau: along(lambda p, t: p.followed(t, tau))
        )
        contrast = (
            skin.contrast_per_N * contact_force * catalogue.contrast_factor(laws, force, peak)
        )
        contrast = np.where(touched, np.maximum(contrast, LEAST_CONDUCTIVITY - 1.0), 0.0)
        radius = 0.5 * states["probe_mm"].to_numpy(float) * catalogue.radius_factor(laws, force)
        minutes = states["time_s"].to_numpy(float) / 60.0
        deg, _ = self.electrodes(laws)
        rim = skin.radius_mm * self._shape(laws).rim(np.radians(deg))
        z = catalogue.impedivity(
            laws,
            np.full(len(deg), skin.contact_impedivity_ohm_m2),
            minutes,
            np.where(touched, force, 0.0),
            np.abs(rim - place[:, None]),
        )
        sigma = catalogue.conductivity(laws, skin.conductivity_S_per_m, minutes)
        siemens = np.where(touched, catalogue.grounding(laws, force), 0.0)
        return Touches(touched, place, radius, contrast, force, minutes, press, z, sigma, siemens)

    def electrodes(self, laws: list[dict]) -> tuple[np.ndarray, np.ndarray]:
        """The true angles, degrees, and widths, mm, of the electrodes (n,)."""
        deg, radius = np.array(self.skin.electrode_deg), self.skin.radius_mm
        assert radius is not None
        width_mm = np.full(len(deg), self.skin.electrode_width_mm)
        return catalogue.electrodes(laws, deg, width_mm, radius)

    def _shape(self, laws: list[dict]) -> Shape:
        assert self.skin.radius_mm is not None
        return catalogue.outline(laws, self.skin.radius_mm, self.outline)

    def _depth(self, laws: list[dict], dent: float) -> Depth | Solid | None:
        """The body of third-dimension, or None for a sheet. Raises ValueError for that law with a
        generator of bodies."""
        skin = self.skin
        law_parameters = next(catalogue.named(laws, "third-dimension"), None)
        if law_parameters is None and not self.generator.solid:
            return None
        depth_mm = (law_parameters or {}).get("depth_mm") or skin.thickness_mm
        assert depth_mm is not None
        height = skin.electrode_height_mm or depth_mm
        z = 0.5 * depth_mm if skin.electrode_z_mm is None else skin.electrode_z_mm
        if not self.generator.solid:
            return Depth(depth_mm, height, z)
        if law_parameters is not None:
            raise ValueError("third-dimension is a law of sheets")
        return Solid(depth_mm, height, z, dent)

    def _solve(self, rows: Touches, laws: list[dict]) -> np.ndarray:
        """(R, n, n) S: the admittance of the skin in every row."""
        skin = self.skin
        assert skin.radius_mm is not None
        shape = self._shape(laws)
        deg, width = self.electrodes(laws)
        always = [(Disc(*patch[:3]), patch[3]) for patch in catalogue.patches(laws)]
        row_inclusions = [self._inclusions(rows, row) + always for row in range(len(rows.touched))]
        rim = skin.radius_mm * shape.rim(2.0 * np.pi * np.arange(512) / 512)
        gaps = [
            np.abs(complex(d.x_mm, d.y_mm) - rim).min() - d.radius_mm
            for d in {disc for inclusions in row_inclusions for disc, _ in inclusions}
        ]
        depth = self._depth(laws, rows.dent)
        body = self._body(shape, deg, width, depth, min(gaps, default=np.inf))
        thick_mm = skin.thickness_mm if depth is None else depth.depth_mm
        sheet = rows.sigma * thick_mm * 1e-3
        solved: dict = {}
        result = np.empty((len(rows.touched), len(deg), len(deg)))
        for row, inclusions in enumerate(row_inclusions):
            length = 1e3 * rows.z[row] * rows.sigma[row] / skin.radius_mm
            leaks = rows.siemens[row] / sheet[row]
            contact = body.contact(length)
            contrasts = tuple(contrast for _, contrast in inclusions)
            layers = rows.layers.get(row)
            key = (length.tobytes(), tuple(inclusions), leaks, row if layers else None)
            if key not in solved:
                place = body.place(tuple(disc for disc, _ in inclusions))
                radial = None
                if layers is not None:
                    radial = Radial.layered(*layers)
                elif leaks > 0:
                    touch_inclusion = inclusions[0]
                    around = self._around(touch_inclusion[0], inclusions[1:])
                    radial = Radial.leaking(
                        touch_inclusion[0].radius_mm, touch_inclusion[1], leaks / around, 1.0
                    )
                solved[key] = place.admittance(contact, contrasts, radial)
            result[row] = solved[key] * sheet[row]
        return 0.5 * (result + np.swapaxes(result, 1, 2))

    @staticmethod
    def _inclusions(rows: Touches, row: int) -> list[tuple[Disc, float]]:
        touch_inclusion = []
        acts = rows.contrast[row] != 0 or rows.siemens[row] > 0 or row in rows.layers
        if rows.touched[row] and acts:
            place, radius = rows.place[row], rows.radius_mm[row]
            if row in rows.layers:
                radius = rows.layers[row][0][-1]
            disc = Disc(float(place.real), float(place.imag), float(radius))
            touch_inclusion = [(disc, float(rows.contrast[row]))]
        return touch_inclusion + rows.inclusions.get(row, [])

    @staticmethod
    def _around(disc: Disc, outer_inclusions: list[tuple[Disc, float]]) -> float:
        """The relative conductivity around a disc within other discs."""
        value = 1.0
        for outer, contrast in outer_inclusions:
            if np.hypot(disc.x_mm - outer.x_mm, disc.y_mm - outer.y_mm) < outer.radius_mm:
                value *= 1.0 + contrast
        return value

    def _body(
        self,
        shape: Shape,
        deg: np.ndarray,
        width: np.ndarray,
        depth: Depth | Solid | None,
        gap_mm: float,
    ) -> "_CachedBody":
        """A body that resolves a gap, rounded down so that similar gaps share it."""
        fit = None
        if np.isfinite(gap_mm):
            if gap_mm <= 0:
                raise ValueError(f"an inclusion leaves the skin by {-gap_mm:g} mm")
            fit = float(2.0 ** (np.floor(2.0 * np.log2(gap_mm)) / 2.0))
        key = (repr(shape), deg.tobytes(), width.tobytes(), depth, fit)

        def make() -> _CachedBody:
            return _CachedBody(
                self.generator.body(Drawing(shape, deg, width, depth, fit, self.resolution))
            )

        return _cached(self._bodies, key, make, 6)


class _CachedBody:
    """A body with a cache of its latest contacts and places."""

    def __init__(self, body: AnyBody):
        self.body = body
        self._contacts: OrderedDict = OrderedDict()
        self._places: OrderedDict = OrderedDict()

    def contact(self, length: np.ndarray) -> Any:
        """`Body.contact`, cached."""
        return _cached(self._contacts, length.tobytes(), lambda: self.body.contact(length), 2)

    def place(self, discs: tuple[Disc, ...]) -> Any:
        """`Body.place`, cached."""
        return _cached(self._places, discs, lambda: self.body.place(discs), 160)


def _cached(cache: OrderedDict, key: Hashable, make: Callable[[], T], size: int) -> T:
    """The value of a key, made where it is missing; the cache holds the `size` latest."""
    if key in cache:
        cache.move_to_end(key)
    else:
        cache[key] = make()
        if len(cache) > size:
            cache.popitem(last=False)
    return cache[key]


def _interpolated(values: np.ndarray, nodes: np.ndarray, position: np.ndarray) -> np.ndarray:
    """(N, M): the polynomials through values (K, N, M) at nodes (K,), at each reading's position
    (N, M)."""
    if len(nodes) == 1:
        return values[0]
    inverse = np.linalg.inv(np.vander(nodes, increasing=True))
    coefficient = np.einsum("jk,knm->jnm", inverse, values)
    return sum(c * position**power for power, c in enumerate(coefficient))
