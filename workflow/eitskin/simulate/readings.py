"""The frames of a recording as the simulator has them: touch, skin, wiring, instrument, clock.

Effects are applied stage by stage, whatever their order in the list; within a stage in the order
of effects.effect.ORDER, else in the list's.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress, product
from typing import TypeVar

import numpy as np
import pandas as pd

from eitskin.effects.effect import (
    ORDER,
    ClockEffect,
    Effect,
    ForceEffect,
    Frames,
    InstrumentEffect,
    LeakEffect,
    Moment,
    Setting,
    SkinEffect,
    TouchEffect,
    WiringEffect,
)
from eitskin.errors import InputError
from eitskin.physics.force_history import ForceHistory
from eitskin.physics.forward import Forward, channel_values, measurable
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin
from eitskin.physics.solver import SolvedSkins
from eitskin.progress import patient
from eitskin.simulate.interpolation import enough_nodes, lagrange
from eitskin.simulate.leaks import leaking

Kind = TypeVar("Kind", bound=Effect)
Made = TypeVar("Made")

LEAST_CONDUCTIVITY = 1e-3  # of the background's, inside a touch
KEPT_SKINS = 16
KEPT_BYTES = 1 << 30  # of these, of which the largest bodies are fewer
MOST_SKINS = 32  # spent on finding out between which others are interpolated
FEW_SKINS = 4  # that are solved one by one
# Where between the forces of its first and last channel, -1 to 1, a frame is solved.
SKEW_NODES = np.cos(np.pi * np.arange(5) / 4)


def of_stage(chosen: list[Setting], stage: str) -> list[Setting]:
    """The settings of one stage, in the order in which they apply."""
    order = ORDER.get(stage, (None,))
    found = [setting for setting in chosen if setting.effect.stage == stage]
    return sorted(found, key=lambda setting: order.index(setting.effect.order))


def of_kind(chosen: list[Setting], kind: type[Kind]) -> list[tuple[Kind, Setting]]:
    """The effects of one class with their settings, in the order in which they apply."""
    return [(s.effect, s) for s in of_stage(chosen, kind.stage) if isinstance(s.effect, kind)]


def made(effect: Effect, value: Made, like: Made) -> Made:
    """What an effect makes, which is of the type and shape of `like`; InputError for anything
    else."""
    of_value, of_like = (getattr(one, "shape", "") for one in (value, like))
    if not isinstance(value, type(like)) or of_value != of_like:
        found, expected = f"{type(value).__name__}{of_value}", f"{type(like).__name__}{of_like}"
        raise InputError(f"effect {effect.name}", "what it returns", found, expected)
    return value


def apply_force(frames: Frames, chosen: list[Setting]) -> Frames:
    """`frames` with the true force, by every effect on the force reported."""
    effects = of_kind(chosen, ForceEffect)
    if not effects:
        return frames
    assert frames.history is not None
    history = frames.history
    for effect, setting in effects:
        history = made(effect, effect.change(history, setting), history)
    return replace(frames, force_N=history.force_N(), history=history)


def apply_touch(touches: pd.DataFrame, chosen: list[Setting], frames: Frames) -> pd.DataFrame:
    """Touches with every effect of `chosen` on what a touch is, once the true force is known."""
    for effect, setting in of_kind(chosen, TouchEffect):
        touches = made(effect, effect.change(touches, setting, frames), touches)
    return touches


def apply_skin(geometry: Geometry, chosen: list[Setting], moment: Moment) -> Geometry:
    """The geometry at a moment, with every skin effect of `chosen`.

    Raises InputError for an effect on the contacts of point electrodes.
    """
    for effect, setting in of_kind(chosen, SkinEffect):
        if effect.on_contacts and geometry.points:
            place = f"effect {effect.name}"
            raise InputError(place, "name", "point electrodes", "electrodes with a width")
        geometry = made(effect, effect.change(geometry, setting, moment), geometry)
    return geometry


def on_contact(chosen: list[Setting]) -> bool:
    """Whether one of `chosen` needs the touch as one more terminal."""
    return any(effect.on_contact for effect, _ in of_kind(chosen, LeakEffect))


def apply_wiring(
    impedance: np.ndarray,
    chosen: list[Setting],
    drives: np.ndarray,
    sink_grounded: bool = False,
    force_N: np.ndarray | None = None,
) -> np.ndarray:
    """Potentials (N, D, n) V per A at the board of a skin `impedance` (N, n, n) ohm.

    drives (D, 2): source and sink as the board names them. Where `on_contact(chosen)`, the
    impedance is (N, n + 1, n + 1), the last terminal the contact, 0 where there is none, and
    force_N (N,) is the true force.
    """
    leaks, wires = of_kind(chosen, LeakEffect), of_kind(chosen, WiringEffect)
    for effect, setting in reversed(wires):
        drives = effect.driven(drives, setting)
    potential = np.swapaxes(impedance[:, :, drives[:, 0]] - impedance[:, :, drives[:, 1]], 1, 2)
    if leaks:
        frames, terminals = impedance.shape[:2]
        force_N = np.zeros(frames) if force_N is None else force_N
        electrodes = terminals - on_contact(chosen)
        admittance = np.zeros((frames, terminals))
        for leak, setting in leaks:
            own = electrodes + leak.on_contact
            taken = leak.admittance(setting, force_N, own)
            admittance[:, :own] += made(leak, taken, admittance[:, :own])
        if on_contact(chosen):
            admittance[impedance[:, -1, -1] == 0.0, -1] = 0.0
        sink_grounded = sink_grounded or any(leak.grounds_sink for leak, _ in leaks)
        potential = leaking(potential, admittance, impedance, drives, sink_grounded)
    if on_contact(chosen):
        potential, impedance = potential[:, :, :-1], impedance[:, :-1, :-1]
    for effect, setting in wires:
        seen = effect.change(potential, setting, drives, impedance, sink_grounded)
        potential = made(effect, seen, potential)
    return potential


def apply_instrument(voltage: np.ndarray, chosen: list[Setting], frames: Frames) -> np.ndarray:
    """Readings (N, M) V of `voltage` (N, M) V with every instrument effect of `chosen`."""
    for effect, setting in of_kind(chosen, InstrumentEffect):
        voltage = made(effect, effect.change(voltage, setting, frames), voltage)
    return voltage


def simulate(
    states: pd.DataFrame,
    press: np.ndarray,
    skin: Skin,
    channels: np.ndarray,
    chosen: list[Setting],
    accuracy: str = "diagnose",
    frame_s: float | None = None,
    sink_grounded: bool = False,
    force_max_N: float | None = None,
    near: Forward | None = None,
    progress: bool = False,
) -> np.ndarray:
    """Noise-free, signed readings (N, M) V of frames with effects at definite values.

    states: time_s, touch, x_mm, y_mm, force_N, probe_mm, one row a frame; press (N,) as
    `recording.presses`; force_max_N: the recording's largest force where the states are a query.
    Frames that share a skin share its solve; where an effect of the skin follows time or force,
    frames have skins of their own. `near`: a solved skin, to share with. Raises InputError where
    `skin` or a touched state lacks a value that a simulation needs, and where a channel has none.
    """
    shared = SolvedSkins(*[near] if near else [])
    sensed = sense(
        states, press, skin, channels, chosen, accuracy, frame_s, force_max_N, shared, progress
    )
    assert skin.current_A is not None
    return read(sensed, skin.current_A, chosen, sink_grounded)


@dataclass(frozen=True)
class Sensed:
    """What a skin answers before the board has it, of N frames at K forces of each, `nodes`.

    nodes (K,), and within (N, M), the force each channel sees: from that of the frame's first
    channel, -1, to that of its last, 1.
    """

    solve: "_Solver"
    nodes: np.ndarray
    within: np.ndarray
    frames: Frames

    @cached_property
    def transfer_impedance(self) -> np.ndarray:
        """(K N, n, n) ohm."""
        return self.solve()

    @cached_property
    def with_contact(self) -> np.ndarray:
        """(K N, n + 1, n + 1) ohm: the contact is the last terminal, 0 where there is none."""
        return self.solve(contact=True)

    @cached_property
    def plain(self) -> np.ndarray:
        """(N, M) V per A: readings without wiring and instrument."""
        voltage = measurable(channel_values(self.transfer_impedance, self.frames.channels))
        return _over_frame(voltage, self)

    @property
    def nbytes(self) -> int:
        """Bytes of its transfer impedances, its readings and the force that each of them sees."""
        terminals = len(self.solve.base.electrode_deg)
        return 8 * (len(self.solve.touches) * terminals**2 + 3 * self.within.size)

    @property
    def force_N(self) -> np.ndarray:
        """(K N,): the true force, 0 where untouched."""
        return self.solve.force_N

    @property
    def moments(self) -> list[Moment]:
        """(N,): when and how the skin of each frame is touched, in the frame's middle."""
        solve, count = self.solve, len(self.frames.time_s)
        middle = slice(len(self.nodes) // 2 * count, (len(self.nodes) // 2 + 1) * count)
        columns = (solve.minutes, solve.force_N, *solve.xy_mm.T)
        return [Moment(*row) for row in np.column_stack(columns)[middle].tolist()]


def sense(
    states: pd.DataFrame,
    press: np.ndarray,
    skin: Skin,
    channels: np.ndarray,
    chosen: list[Setting],
    accuracy: str = "diagnose",
    frame_s: float | None = None,
    force_max_N: float | None = None,
    near: SolvedSkins | None = None,
    progress: bool = False,
    history: ForceHistory | None = None,
) -> Sensed:
    """The stages of touch, skin and clock of `simulate`; arguments and errors as there, but for
    those of the skin's solve, which waits until it is asked for. `history`: the force in each
    press, where it is known better than from the frames."""
    for key in ("current_A", "contrast_per_N"):
        if getattr(skin, key) is None:
            raise InputError("skin", key, "null", "a value, to simulate with")
    touched = states["touch"].to_numpy(bool)
    for key in ("x_mm", "y_mm", "force_N", "probe_mm"):
        unknown = touched & states[key].isna().to_numpy()
        if unknown.any():
            place = f"column {key}, row {np.flatnonzero(unknown)[0]}"
            raise InputError("states", place, "null", "a number where touched, to simulate with")
    time_s = states["time_s"].to_numpy(float)
    force_N = np.where(touched, states["force_N"].to_numpy(float), 0.0)
    largest = force_N.max(initial=0.0) if force_max_N is None else force_max_N
    history = history or ForceHistory.of_frames(time_s, force_N, press)
    frames = Frames(time_s, force_N, channels, history, frame_s, float(largest))
    frames = apply_force(frames, chosen)
    frames, middle, half = _skewed(frames, chosen)
    nodes = SKEW_NODES if half.any() else np.zeros(1)
    tables = [_touches(states, middle + node * half, skin, chosen, frames) for node in nodes]
    solve = _Solver(
        pd.concat(tables, ignore_index=True),
        np.tile(touched, len(nodes)),
        np.tile(time_s / 60.0, len(nodes)),
        Geometry.from_skin(skin),
        chosen,
        accuracy,
        near or SolvedSkins(),
        progress,
    )
    within = (frames.seen_N - middle[:, None]) / np.where(half != 0.0, half, 1.0)[:, None]
    return Sensed(solve, nodes, within, frames)


def _skewed(frames: Frames, chosen: list[Setting]) -> tuple[Frames, np.ndarray, np.ndarray]:
    """`frames` with the force that each channel sees, its middle and half its range (N,) N.

    Before a press and after it there is no force: what a frame sees there is 0.
    """
    moment = np.linspace(-0.5, 0.5, len(frames.channels))
    seen = np.repeat(frames.force_N[:, None], len(moment), axis=1)
    for effect, setting in of_kind(chosen, ClockEffect):
        shift = made(effect, effect.force_shift(setting, frames), frames.force_N)
        seen += shift[:, None] * moment
    seen = np.maximum(seen, 0.0)
    first, last = seen[:, 0], seen[:, -1]
    return replace(frames, seen_N=seen), 0.5 * (first + last), 0.5 * (last - first)


def read(
    sensed: Sensed, current_A: float, chosen: list[Setting], sink_grounded: bool = False
) -> np.ndarray:
    """The stages of wiring and instrument of `simulate`: readings (N, M) V."""
    frames = sensed.frames
    channels = frames.channels
    asked = any(not effect.on_readings for effect, _ in of_kind(chosen, InstrumentEffect))
    above_sink = None
    if asked or of_stage(chosen, "wiring"):
        drives, drive = _drives(channels)
        impedance = sensed.with_contact if on_contact(chosen) else sensed.transfer_impedance
        potential = apply_wiring(impedance, chosen, drives, sink_grounded, sensed.force_N)
        plus, minus = (potential[:, drive, channels[:, k]] for k in (2, 3))
        voltage = current_A * _over_frame(measurable(plus - minus), sensed)
        if asked:
            mean = measurable(0.5 * (plus + minus) - potential[:, drive, channels[:, 1]])
            above_sink = current_A * _over_frame(mean, sensed)
    else:
        voltage = current_A * sensed.plain
    return apply_instrument(voltage, chosen, replace(frames, above_sink_V=above_sink))


def _touches(
    states: pd.DataFrame, force_N: np.ndarray, skin: Skin, chosen: list[Setting], frames: Frames
) -> pd.DataFrame:
    """What each frame's touch is to the skin at forces (N,); `contrast` among its columns."""
    force_N = np.maximum(force_N, 0.0)
    table = pd.DataFrame(
        {
            "x_mm": states["x_mm"].to_numpy(float),
            "y_mm": states["y_mm"].to_numpy(float),
            "radius_mm": 0.5 * states["probe_mm"].to_numpy(float),
            "force_N": force_N,
            "felt_N": force_N,
            "contrast_per_N": skin.contrast_per_N,
        }
    )
    table = apply_touch(table, chosen, frames)
    contrast = table["contrast_per_N"] * table["felt_N"]
    return table.assign(contrast=np.maximum(contrast, LEAST_CONDUCTIVITY - 1.0))


@dataclass(frozen=True)
class _Solver:
    """Every row of `touches` on the skin that it finds at its minutes and force."""

    touches: pd.DataFrame
    touched: np.ndarray
    minutes: np.ndarray
    base: Geometry
    chosen: list[Setting]
    accuracy: str
    near: SolvedSkins
    progress: bool

    @property
    def force_N(self) -> np.ndarray:
        """(N,): the true force, 0 where untouched."""
        return np.where(self.touched, self.touches["force_N"].to_numpy(float), 0.0)

    @property
    def xy_mm(self) -> np.ndarray:
        """(N, 2): where each row is touched."""
        return self.touches[["x_mm", "y_mm"]].to_numpy(float)

    def __call__(self, contact: bool = False) -> np.ndarray:
        """(N, n, n) ohm: transfer impedance of every row; with `contact`, (N, n + 1, n + 1)."""
        terminals = len(self.base.electrode_deg) + int(contact)
        result = np.zeros((len(self.touches), terminals, terminals))
        places = self.touches[["x_mm", "y_mm", "radius_mm"]].to_numpy()
        contrast = self.touches["contrast"].to_numpy()
        for forward, rows, weight in patient(self._skins(), "skins", self.progress):
            value = np.pad(forward.transfer_impedance(), (0, int(contact)))
            result[rows] += weight[:, None, None] * value
            found = [
                (place, at)
                for place, at in _places(places[rows], self.touched[rows])
                if contact or contrast[rows[at]].any()
            ]
            found = list(compress(found, forward.meets([place for place, _ in found])))
            here = [place for place, _ in found]
            self.near.effort += len(here) * forward.touch_effort
            modes = [forward.contact(*p) for p in here] if contact else forward.places(here)
            for one, (_, at) in zip(modes, found, strict=True):
                change = one.impedance_change(contrast[rows[at]])
                result[rows[at]] += weight[at, None, None] * change
        return result

    def _skins(self) -> Iterator[tuple[Forward, np.ndarray, np.ndarray]]:
        """Skins, the rows (R,) that they are part of, and with what weight (R,).

        Where an effect follows time or force, a row's skin is interpolated between a few, smooth
        as the laws are; where few rows are alike but for time and force, each has its own.
        """
        force, xy = self.force_N, self.xy_mm
        skins = _Skins(self.base, self.chosen, self.accuracy, self.near)
        groups, follows = _alike(skins, np.column_stack([self.minutes, force]), xy)
        for rows in groups:
            own = np.column_stack([self.minutes[rows], force[rows]])
            own[:, ~follows] = own[0, ~follows]
            place = xy[rows[0]]
            moments, which = np.unique(own, axis=0, return_inverse=True)
            weights = np.eye(len(moments))[which.ravel()]
            few = skins.few(moments, place)
            if few is not None:
                moments = np.array(list(product(*few)))
                by_time, by_force = (lagrange(n, own[:, k]) for k, n in enumerate(few))
                weights = (by_time[:, :, None] * by_force[:, None, :]).reshape(len(rows), -1)
            for (minutes, force_N), weight in zip(moments, weights.T, strict=True):
                some = np.flatnonzero(weight)
                yield skins.at(minutes, force_N, place), rows[some], weight[some]


class _Skins:
    """Solved skins by the moment at which they are asked for; the latest are kept."""

    def __init__(self, base: Geometry, chosen: list[Setting], accuracy: str, near: SolvedSkins):
        self.base, self.chosen, self.accuracy, self.near = base, chosen, accuracy, near
        self._solved: dict[tuple, Forward] = {}

    def geometry(self, minutes: float, force_N: float, place: np.ndarray) -> Geometry:
        """The skin's at a moment; place (x, y) mm, NaN where untouched."""
        return apply_skin(self.base, self.chosen, Moment(minutes, force_N, *place))

    def at(self, minutes: float, force_N: float, place: np.ndarray) -> Forward:
        """The skin at a moment, solved."""
        key = (minutes, force_N, *place)
        if key not in self._solved:
            geometry = self.geometry(minutes, force_N, place)
            solved = self.near.solve(geometry, self.accuracy)
            room = KEPT_BYTES // max(solved.nbytes, 1)
            while len(self._solved) >= max(min(KEPT_SKINS, room), 1):
                self._solved.pop(next(iter(self._solved)))
            self._solved[key] = solved
        return self._solved[key]

    def few(self, moments: np.ndarray, place: np.ndarray) -> list[np.ndarray] | None:
        """Minutes and forces between all of which skins at moments (K, 2) are interpolated; None
        where that takes as many as there are."""
        if len(moments) <= FEW_SKINS:
            return None
        found = []
        for axis in (0, 1):
            nodes = self._nodes(moments, axis, place)
            if nodes is None:
                return None
            found.append(nodes)
        return found if len(found[0]) * len(found[1]) < len(moments) else None

    def _nodes(self, moments: np.ndarray, axis: int, place: np.ndarray) -> np.ndarray | None:
        low, high = moments.min(axis=0), moments.max(axis=0)
        if low[axis] == high[axis]:
            return low[[axis]]

        def impedance(t: float) -> np.ndarray:
            moment = 0.5 * (low + high)
            moment[axis] = t
            minutes, force_N = moment
            return self.at(minutes, force_N, place).transfer_impedance()

        most = min(len(np.unique(moments[:, axis])) - 1, MOST_SKINS)
        return enough_nodes(impedance, low[axis], high[axis], most)


def _alike(
    skins: _Skins, moments: np.ndarray, xy: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Groups of rows whose skins are the same wherever their moments (N, 2), minutes and force,
    are: those without a force, and those at places (N, 2) that no effect makes a difference
    between; and whether skins follow time and force (2,), as their geometries show."""
    drivers = {s.effect.driver for s in of_stage(skins.chosen, "skin")} - {"static"}
    follows = np.array([name in drivers for name in ("time", "force")])
    if not drivers:
        return [np.arange(len(moments))], follows
    pressed = moments[:, 1] > 0
    minutes, forces = _spread(moments[:, 0]), _spread(moments[pressed, 1])
    places = list(zip(pressed.tolist(), map(bytes, xy), strict=True))
    skin_at: dict[tuple, tuple] = {}  # by force, then by time
    for (touch, key), place in zip(places, xy, strict=True):
        if (touch, key) not in skin_at:
            skin_at[touch, key] = tuple(
                tuple(skins.geometry(t, f, place).key() for t in minutes)
                for f in (forces if touch else (0.0,))
            )
    by_time = {through for skin in skin_at.values() for through in skin}
    follows |= [any(len(set(s)) > 1 for s in some) for some in (by_time, skin_at.values())]
    found: dict[tuple, list[int]] = {}
    for row, place in enumerate(places):
        skin = skin_at[place]
        found.setdefault((place[0], skin) if follows[1] else skin[0], []).append(row)
    return [np.array(rows) for rows in found.values()], follows


def _spread(values: np.ndarray) -> np.ndarray:
    """The least, the middle and the largest of values, each once."""
    if not len(values):
        return values
    low, high = values.min(), values.max()
    return np.unique([low, 0.5 * (low + high), high])


def _places(places: np.ndarray, touched: np.ndarray) -> list[tuple[tuple, list[int]]]:
    """Places (x, y, radius) of touched rows, in order of appearance, with the rows of each."""
    found: dict[tuple, list[int]] = {}
    for row in np.flatnonzero(touched).tolist():
        found.setdefault(tuple(places[row].tolist()), []).append(row)
    return list(found.items())


def _drives(channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drives (D, 2) source, sink, and the drive (M,) of each channel."""
    drives, drive = np.unique(channels[:, :2], axis=0, return_inverse=True)
    return drives, drive.ravel()


def _over_frame(values: np.ndarray, sensed: Sensed) -> np.ndarray:
    """(N, M): `values` (K N, M) at the nodes of each frame, each channel's at the force it sees.

    The polynomial through the nodes, by Lagrange's formula.
    """
    nodes, within = sensed.nodes, sensed.within
    if len(nodes) == 1:
        return values
    values = values.reshape(len(nodes), -1, values.shape[-1])
    weights = lagrange(nodes, within.ravel()).reshape(*within.shape, len(nodes))
    return np.einsum("nmk,knm->nm", weights, values)
