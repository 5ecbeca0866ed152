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
from eitskin.simulate.leaks import leaking_potential

Kind = TypeVar("Kind", bound=Effect)
Value = TypeVar("Value")

LEAST_CONDUCTIVITY = 1e-3  # inside a touch, over the background's: keeps contrasts above -1
MAX_SKINS, MAX_SKIN_BYTES = 16, 1 << 30  # solved skins kept at once; of large bodies fewer
MOST_NODE_SKINS = 32  # solved to find the nodes of an interpolation between skins
FEW_SKINS = 4  # up to so many skins are solved one by one, not interpolated
# Chebyshev nodes between the forces of a frame's first and last channel, at which it is solved.
SKEW_NODES = np.cos(np.pi * np.arange(5) / 4)


def stage_settings(settings: list[Setting], stage: str) -> list[Setting]:
    """The settings of one stage, in the order in which they apply."""
    order = ORDER.get(stage, (None,))
    selection = [setting for setting in settings if setting.effect.stage == stage]
    return sorted(selection, key=lambda setting: order.index(setting.effect.order))


def effects_of_class(settings: list[Setting], kind: type[Kind]) -> list[tuple[Kind, Setting]]:
    """The effects of one class with their settings, in the order in which they apply."""
    return [
        (setting.effect, setting)
        for setting in stage_settings(settings, kind.stage)
        if isinstance(setting.effect, kind)
    ]


def checked_change(effect: Effect, value: Value, template: Value) -> Value:
    """`value`, the result of an effect. Raises InputError unless its type and shape are those of
    `template`."""
    shape, template_shape = (getattr(array, "shape", "") for array in (value, template))
    if not isinstance(value, type(template)) or shape != template_shape:
        actual = f"{type(value).__name__}{shape}"
        expected = f"{type(template).__name__}{template_shape}"
        raise InputError(f"effect {effect.name}", "what it returns", actual, expected)
    return value


def apply_force(frames: Frames, settings: list[Setting]) -> Frames:
    """`frames` with the true force, after every effect on the reported force."""
    effects = effects_of_class(settings, ForceEffect)
    if not effects:
        return frames
    assert frames.history is not None
    history = frames.history
    for effect, setting in effects:
        history = checked_change(effect, effect.change(history, setting), history)
    return replace(frames, force_N=history.force_N(), history=history)


def apply_touch(touches: pd.DataFrame, settings: list[Setting], frames: Frames) -> pd.DataFrame:
    """Touches after every touch effect of `settings`; the true force is known."""
    for effect, setting in effects_of_class(settings, TouchEffect):
        touches = checked_change(effect, effect.change(touches, setting, frames), touches)
    return touches


def apply_skin(geometry: Geometry, settings: list[Setting], moment: Moment) -> Geometry:
    """The geometry at a moment, after every skin effect of `settings`.

    Raises InputError for an effect on the contacts of point electrodes.
    """
    for effect, setting in effects_of_class(settings, SkinEffect):
        if effect.on_contacts and geometry.points:
            place = f"effect {effect.name}"
            raise InputError(place, "name", "point electrodes", "electrodes with a width")
        geometry = checked_change(effect, effect.change(geometry, setting, moment), geometry)
    return geometry


def on_contact(settings: list[Setting]) -> bool:
    """Whether an effect of `settings` needs the touch as a further terminal."""
    return any(effect.on_contact for effect, _ in effects_of_class(settings, LeakEffect))


def apply_wiring(
    impedance: np.ndarray,
    settings: list[Setting],
    drives: np.ndarray,
    sink_grounded: bool = False,
    force_N: np.ndarray | None = None,
) -> np.ndarray:
    """Potentials (N, D, n) V per A at the board of a skin with `impedance` (N, n, n) ohm.

    drives (D, 2): source and sink as the board names them. Where `on_contact(settings)`, the
    impedance is (N, n + 1, n + 1) with the contact as its last terminal, 0 where the skin is
    untouched, and force_N (N,) is the true force.
    """
    leaks, wires = effects_of_class(settings, LeakEffect), effects_of_class(settings, WiringEffect)
    for effect, setting in reversed(wires):
        drives = effect.driven(drives, setting)
    potential = np.swapaxes(impedance[:, :, drives[:, 0]] - impedance[:, :, drives[:, 1]], 1, 2)
    if leaks:
        frames, terminals = impedance.shape[:2]
        force_N = np.zeros(frames) if force_N is None else force_N
        electrodes = terminals - on_contact(settings)
        admittance = np.zeros((frames, terminals))
        for leak, setting in leaks:
            leak_terminals = electrodes + leak.on_contact
            leak_admittance = leak.admittance(setting, force_N, leak_terminals)
            admittance[:, :leak_terminals] += checked_change(
                leak, leak_admittance, admittance[:, :leak_terminals]
            )
        if on_contact(settings):
            admittance[impedance[:, -1, -1] == 0.0, -1] = 0.0
        sink_grounded = sink_grounded or any(leak.grounds_sink for leak, _ in leaks)
        potential = leaking_potential(potential, admittance, impedance, drives, sink_grounded)
    if on_contact(settings):
        potential, impedance = potential[:, :, :-1], impedance[:, :-1, :-1]
    for effect, setting in wires:
        changed = effect.change(potential, setting, drives, impedance, sink_grounded)
        potential = checked_change(effect, changed, potential)
    return potential


def apply_instrument(voltage: np.ndarray, settings: list[Setting], frames: Frames) -> np.ndarray:
    """Readings (N, M) V from `voltage` (N, M) V after every instrument effect of `settings`."""
    for effect, setting in effects_of_class(settings, InstrumentEffect):
        voltage = checked_change(effect, effect.change(voltage, setting, frames), voltage)
    return voltage


def simulate(
    states: pd.DataFrame,
    press: np.ndarray,
    skin: Skin,
    channels: np.ndarray,
    settings: list[Setting],
    accuracy: str = "diagnose",
    frame_s: float | None = None,
    sink_grounded: bool = False,
    force_max_N: float | None = None,
    solved_skin: Forward | None = None,
    progress: bool = False,
) -> np.ndarray:
    """Noise-free, signed readings (N, M) V of frames with effects at definite values.

    states: time_s, touch, x_mm, y_mm, force_N, probe_mm, one row a frame; press (N,) as
    `recording.presses`; force_max_N: the recording's largest force where the states are a query.
    Frames on the same skin share its solution; where a skin effect follows time or force, every
    frame has its own skin. solved_skin: shares its parts with the skins to be solved. Raises
    InputError where `skin` or a touched state lacks a value that a simulation needs, and where a
    channel has no value.
    """
    solved_skins = SolvedSkins(*[solved_skin] if solved_skin else [])
    sensed = sense(
        states,
        press,
        skin,
        channels,
        settings,
        accuracy,
        frame_s,
        force_max_N,
        solved_skins,
        progress,
    )
    assert skin.current_A is not None
    return read(sensed, skin.current_A, settings, sink_grounded)


@dataclass(frozen=True)
class Sensed:
    """The answer of a skin to N frames before the board, at K forces of each frame, `nodes`.

    nodes (K,) and within (N, M): the force that each channel sees, from -1, that of the frame's
    first channel, to 1, that of its last.
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
        """(K N, n + 1, n + 1) ohm: with the contact as the last terminal, 0 where the skin is
        untouched."""
        return self.solve(contact=True)

    @cached_property
    def plain(self) -> np.ndarray:
        """(N, M) V per A: readings without wiring and instrument."""
        voltage = measurable(channel_values(self.transfer_impedance, self.frames.channels))
        return _over_frame(voltage, self)

    @property
    def nbytes(self) -> int:
        """Bytes of the transfer impedances, the readings and the force that each channel sees."""
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
    settings: list[Setting],
    accuracy: str = "diagnose",
    frame_s: float | None = None,
    force_max_N: float | None = None,
    solved_skins: SolvedSkins | None = None,
    progress: bool = False,
    history: ForceHistory | None = None,
) -> Sensed:
    """The stages of touch, skin and clock of `simulate`, with its arguments and errors, except
    that the skin is solved on first use. history: the force in each press, where it is known
    better than from the frames."""
    for key in ("current_A", "contrast_per_N"):
        if getattr(skin, key) is None:
            raise InputError("skin", key, "null", "a value, to simulate with")
    touched = states["touch"].to_numpy(bool)
    for key in ("x_mm", "y_mm", "force_N", "probe_mm"):
        is_missing = touched & states[key].isna().to_numpy()
        if is_missing.any():
            place = f"column {key}, row {np.flatnonzero(is_missing)[0]}"
            raise InputError("states", place, "null", "a number where touched, to simulate with")
    time_s = states["time_s"].to_numpy(float)
    force_N = np.where(touched, states["force_N"].to_numpy(float), 0.0)
    largest = force_N.max(initial=0.0) if force_max_N is None else force_max_N
    history = history or ForceHistory.of_frames(time_s, force_N, press)
    frames = Frames(time_s, force_N, channels, history, frame_s, float(largest))
    frames = apply_force(frames, settings)
    frames, middle, half = _skewed(frames, settings)
    nodes = SKEW_NODES if half.any() else np.zeros(1)
    tables = [_touches(states, middle + node * half, skin, settings, frames) for node in nodes]
    solve = _Solver(
        pd.concat(tables, ignore_index=True),
        np.tile(touched, len(nodes)),
        np.tile(time_s / 60.0, len(nodes)),
        Geometry.from_skin(skin),
        settings,
        accuracy,
        solved_skins or SolvedSkins(),
        progress,
    )
    within = (frames.seen_N - middle[:, None]) / np.where(half != 0.0, half, 1.0)[:, None]
    return Sensed(solve, nodes, within, frames)


def _skewed(frames: Frames, settings: list[Setting]) -> tuple[Frames, np.ndarray, np.ndarray]:
    """`frames` with the force that each channel sees, its middle (N,) and half its range (N,) N.

    Outside a press the force is 0, and so is what a channel sees there.
    """
    channel_time = np.linspace(-0.5, 0.5, len(frames.channels))
    channel_force = np.repeat(frames.force_N[:, None], len(channel_time), axis=1)
    for effect, setting in effects_of_class(settings, ClockEffect):
        shift = checked_change(effect, effect.force_shift(setting, frames), frames.force_N)
        channel_force += shift[:, None] * channel_time
    channel_force = np.maximum(channel_force, 0.0)
    start, end = channel_force[:, 0], channel_force[:, -1]
    return replace(frames, seen_N=channel_force), 0.5 * (start + end), 0.5 * (end - start)


def read(
    sensed: Sensed, current_A: float, settings: list[Setting], sink_grounded: bool = False
) -> np.ndarray:
    """The stages of wiring and instrument of `simulate`: readings (N, M) V."""
    frames = sensed.frames
    channels = frames.channels
    needs_potential = any(
        not effect.on_readings for effect, _ in effects_of_class(settings, InstrumentEffect)
    )
    above_sink = None
    if needs_potential or stage_settings(settings, "wiring"):
        drives, drive = _drives(channels)
        impedance = sensed.with_contact if on_contact(settings) else sensed.transfer_impedance
        potential = apply_wiring(impedance, settings, drives, sink_grounded, sensed.force_N)
        plus, minus = (potential[:, drive, channels[:, k]] for k in (2, 3))
        voltage = current_A * _over_frame(measurable(plus - minus), sensed)
        if needs_potential:
            mean = measurable(0.5 * (plus + minus) - potential[:, drive, channels[:, 1]])
            above_sink = current_A * _over_frame(mean, sensed)
    else:
        voltage = current_A * sensed.plain
    return apply_instrument(voltage, settings, replace(frames, above_sink_V=above_sink))


def _touches(
    states: pd.DataFrame, force_N: np.ndarray, skin: Skin, settings: list[Setting], frames: Frames
) -> pd.DataFrame:
    """Touches of the frames at forces (N,), with their `contrast`, after the touch effects."""
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
    table = apply_touch(table, settings, frames)
    contrast = table["contrast_per_N"] * table["felt_N"]
    return table.assign(contrast=np.maximum(contrast, LEAST_CONDUCTIVITY - 1.0))


@dataclass(frozen=True)
class _Solver:
    """Solves every row of `touches` on the skin of its minutes and force."""

    touches: pd.DataFrame
    touched: np.ndarray
    minutes: np.ndarray
    base: Geometry
    settings: list[Setting]
    accuracy: str
    solved_skins: SolvedSkins
    progress: bool

    @property
    def force_N(self) -> np.ndarray:
        """(N,): the true force, 0 where untouched."""
        return np.where(self.touched, self.touches["force_N"].to_numpy(float), 0.0)

    @property
    def xy_mm(self) -> np.ndarray:
        """(N, 2): place of the touch of each row."""
        return self.touches[["x_mm", "y_mm"]].to_numpy(float)

    def __call__(self, contact: bool = False) -> np.ndarray:
        """(N, n, n) ohm: transfer impedance of every row; with `contact`, (N, n + 1, n + 1)."""
        terminals = len(self.base.electrode_deg) + int(contact)
        impedance = np.zeros((len(self.touches), terminals, terminals))
        row_places = self.touches[["x_mm", "y_mm", "radius_mm"]].to_numpy()
        contrast = self.touches["contrast"].to_numpy()
        for forward, rows, weight in patient(self._skins(), "skins", self.progress):
            untouched = np.pad(forward.transfer_impedance(), (0, int(contact)))
            impedance[rows] += weight[:, None, None] * untouched
            touched_places = [
                (place, place_rows)
                for place, place_rows in _places(row_places[rows], self.touched[rows])
                if contact or contrast[rows[place_rows]].any()
            ]
            touched_places = list(
                compress(touched_places, forward.meets([place for place, _ in touched_places]))
            )
            places = [place for place, _ in touched_places]
            self.solved_skins.effort += len(places) * forward.touch_effort
            modes = [forward.contact(*p) for p in places] if contact else forward.places(places)
            for place_modes, (_, place_rows) in zip(modes, touched_places, strict=True):
                change = place_modes.impedance_change(contrast[rows[place_rows]])
                impedance[rows[place_rows]] += weight[place_rows, None, None] * change
        return impedance

    def _skins(self) -> Iterator[tuple[Forward, np.ndarray, np.ndarray]]:
        """Yield skins, the rows (R,) to which they contribute, and their weights (R,).

        Where an effect follows time or force, the skin of a row is interpolated between a few
        skins, as the laws are smooth; where only few rows differ in nothing but time and force,
        each has its own.
        """
        force, xy = self.force_N, self.xy_mm
        skins = _Skins(self.base, self.settings, self.accuracy, self.solved_skins)
        groups, follows = _groups_of_skins(skins, np.column_stack([self.minutes, force]), xy)
        for rows in groups:
            moments = np.column_stack([self.minutes[rows], force[rows]])
            moments[:, ~follows] = moments[0, ~follows]
            place = xy[rows[0]]
            unique_moments, moment_index = np.unique(moments, axis=0, return_inverse=True)
            weights = np.eye(len(unique_moments))[moment_index.ravel()]
            nodes = skins.nodes(unique_moments, place)
            if nodes is not None:
                unique_moments = np.array(list(product(*nodes)))
                by_time, by_force = (
                    lagrange(axis_nodes, moments[:, k]) for k, axis_nodes in enumerate(nodes)
                )
                weights = (by_time[:, :, None] * by_force[:, None, :]).reshape(len(rows), -1)
            for (minutes, force_N), weight in zip(unique_moments, weights.T, strict=True):
                used_rows = np.flatnonzero(weight)
                yield skins.solved(minutes, force_N, place), rows[used_rows], weight[used_rows]


class _Skins:
    """Solved skins by moment; the latest are kept."""

    def __init__(
        self, base: Geometry, settings: list[Setting], accuracy: str, solved_skins: SolvedSkins
    ):
        self.base, self.settings = base, settings
        self.accuracy, self.solved_skins = accuracy, solved_skins
        self._solved: dict[tuple, Forward] = {}

    def geometry(self, minutes: float, force_N: float, place: np.ndarray) -> Geometry:
        """The geometry of the skin at a moment; place (x, y) mm, NaN where untouched."""
        return apply_skin(self.base, self.settings, Moment(minutes, force_N, *place))

    def solved(self, minutes: float, force_N: float, place: np.ndarray) -> Forward:
        """The solved skin at a moment."""
        key = (minutes, force_N, *place)
        if key not in self._solved:
            geometry = self.geometry(minutes, force_N, place)
            solved = self.solved_skins.solve(geometry, self.accuracy)
            room = MAX_SKIN_BYTES // max(solved.nbytes, 1)
            while len(self._solved) >= max(min(MAX_SKINS, room), 1):
                self._solved.pop(next(iter(self._solved)))
            self._solved[key] = solved
        return self._solved[key]

    def nodes(self, moments: np.ndarray, place: np.ndarray) -> list[np.ndarray] | None:
        """Minutes and forces between which skins at moments (K, 2) are interpolated; None where
        that needs as many skins as there are moments."""
        if len(moments) <= FEW_SKINS:
            return None
        nodes = []
        for axis in (0, 1):
            axis_nodes = self._nodes(moments, axis, place)
            if axis_nodes is None:
                return None
            nodes.append(axis_nodes)
        return nodes if len(nodes[0]) * len(nodes[1]) < len(moments) else None

    def _nodes(self, moments: np.ndarray, axis: int, place: np.ndarray) -> np.ndarray | None:
        low, high = moments.min(axis=0), moments.max(axis=0)
        if low[axis] == high[axis]:
            return low[[axis]]

        def impedance(t: float) -> np.ndarray:
            moment = 0.5 * (low + high)
            moment[axis] = t
            minutes, force_N = moment
            return self.solved(minutes, force_N, place).transfer_impedance()

        most_nodes = min(len(np.unique(moments[:, axis])) - 1, MOST_NODE_SKINS)
        return enough_nodes(impedance, low[axis], high[axis], most_nodes)


def _groups_of_skins(
    skins: _Skins, moments: np.ndarray, xy: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Groups of rows whose skins agree whenever their moments (N, 2), minutes and force, do:
    rows without a force, and rows at places (N, 2) that the skin effects do not distinguish; and
    whether skins follow time and force (2,), by comparison of their geometries."""
    skin_settings = stage_settings(skins.settings, "skin")
    drivers = {setting.effect.driver for setting in skin_settings} - {"static"}
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
    over_time = {keys for skin in skin_at.values() for keys in skin}
    over_force = skin_at.values()
    follows |= [any(len(set(keys)) > 1 for keys in series) for series in (over_time, over_force)]
    groups: dict[tuple, list[int]] = {}
    for row, place in enumerate(places):
        skin = skin_at[place]
        groups.setdefault((place[0], skin) if follows[1] else skin[0], []).append(row)
    return [np.array(rows) for rows in groups.values()], follows


def _spread(values: np.ndarray) -> np.ndarray:
    """The least, the middle and the largest of values, without repetition."""
    if not len(values):
        return values
    low, high = values.min(), values.max()
    return np.unique([low, 0.5 * (low + high), high])


def _places(places: np.ndarray, touched: np.ndarray) -> list[tuple[tuple, list[int]]]:
    """Places (x, y, radius) of touched rows, in order of appearance, with the rows of each."""
    rows_at: dict[tuple, list[int]] = {}
    for row in np.flatnonzero(touched).tolist():
        rows_at.setdefault(tuple(places[row].tolist()), []).append(row)
    return list(rows_at.items())


def _drives(channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drives (D, 2) source, sink, and the drive (M,) of each channel."""
    drives, drive = np.unique(channels[:, :2], axis=0, return_inverse=True)
    return drives, drive.ravel()


def _over_frame(values: np.ndarray, sensed: Sensed) -> np.ndarray:
    """(N, M): `values` (K N, M) at the nodes of each frame, interpolated to the force that each
    channel sees, by Lagrange's polynomial."""
    nodes, within = sensed.nodes, sensed.within
    if len(nodes) == 1:
        return values
    values = values.reshape(len(nodes), -1, values.shape[-1])
    weights = lagrange(nodes, within.ravel()).reshape(*within.shape, len(nodes))
    return np.einsum("nmk,knm->nm", weights, values)
