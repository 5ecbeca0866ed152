"""The frames of a recording as the simulator has them: touch, skin, wiring, instrument, clock.

Effects are applied stage by stage, whatever their order in the list; within a stage in the order
of effects.effect.ORDER, else in the list's.
"""

import sys
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from tqdm import tqdm

from eitskin.depth import forward_model
from eitskin.effects.effect import ORDER, ForceEffect, Frames, LeakEffect, Moment, Setting
from eitskin.errors import InputError
from eitskin.force_history import ForceHistory
from eitskin.forward import Forward, channel_values, measurable
from eitskin.geometry import Geometry
from eitskin.leaks import leaking
from eitskin.skin import Skin

LEAST_CONDUCTIVITY = 1e-3  # of the background's, inside a touch
# Where between the forces of its first and last channel, -1 to 1, a frame is solved.
SKEW_NODES = np.cos(np.pi * np.arange(5) / 4)


def of_stage(chosen: list[Setting], stage: str) -> list[Setting]:
    """The settings of one stage, in the order in which they apply."""
    order = ORDER.get(stage, (None,))
    found = [setting for setting in chosen if setting.effect.stage == stage]
    return sorted(found, key=lambda setting: order.index(setting.effect.order))


def apply_force(frames: Frames, chosen: list[Setting]) -> Frames:
    """`frames` with the true force, by every effect on the force reported."""
    effects = [s for s in of_stage(chosen, "touch") if isinstance(s.effect, ForceEffect)]
    if not effects:
        return frames
    history = frames.history
    for setting in effects:
        history = setting.effect.change(history, setting)
    return replace(frames, force_N=history.force_N(), history=history)


def apply_touch(touches: pd.DataFrame, chosen: list[Setting], frames: Frames) -> pd.DataFrame:
    """Touches with every effect of `chosen` on what a touch is, once the true force is known."""
    for setting in of_stage(chosen, "touch"):
        if not isinstance(setting.effect, ForceEffect):
            touches = setting.effect.change(touches, setting, frames)
    return touches


def apply_skin(geometry: Geometry, chosen: list[Setting], moment: Moment) -> Geometry:
    """The geometry at a moment, with every skin effect of `chosen`.

    Raises InputError for an effect on the contacts of point electrodes.
    """
    for setting in of_stage(chosen, "skin"):
        if setting.effect.on_contacts and geometry.points:
            place = f"effect {setting.effect.name}"
            raise InputError(place, "name", "point electrodes", "electrodes with a width")
        geometry = setting.effect.change(geometry, setting, moment)
    return geometry


def on_contact(chosen: list[Setting]) -> bool:
    """Whether one of `chosen` needs the touch as one more terminal."""
    return any(
        isinstance(s.effect, LeakEffect) and s.effect.on_contact for s in of_stage(chosen, "wiring")
    )


def apply_wiring(
    transfer: np.ndarray,
    chosen: list[Setting],
    drives: np.ndarray,
    sink_grounded: bool = False,
    force_N: np.ndarray | None = None,
) -> np.ndarray:
    """Potentials (N, D, n) V per A at the board of a skin `transfer` (N, n, n) ohm.

    drives (D, 2): source and sink as the board names them. Where `on_contact(chosen)`, the
    transfer is (N, n + 1, n + 1), the last terminal the contact, 0 where there is none, and
    force_N (N,) is the true force.
    """
    wiring = of_stage(chosen, "wiring")
    leaks = [s for s in wiring if isinstance(s.effect, LeakEffect)]
    wires = [s for s in wiring if not isinstance(s.effect, LeakEffect)]
    for setting in reversed(wires):
        drives = setting.effect.driven(drives, setting)
    potential = np.swapaxes(transfer[:, :, drives[:, 0]] - transfer[:, :, drives[:, 1]], 1, 2)
    if leaks:
        frames, terminals = transfer.shape[:2]
        force_N = np.zeros(frames) if force_N is None else force_N
        admittance = sum(s.effect.admittance(s, force_N, terminals) for s in leaks)
        if on_contact(chosen):
            admittance[transfer[:, -1, -1] == 0.0, -1] = 0.0
        potential = leaking(potential, admittance, transfer, drives, sink_grounded)
    if on_contact(chosen):
        potential, transfer = potential[:, :, :-1], transfer[:, :-1, :-1]
    for setting in wires:
        potential = setting.effect.change(potential, setting, drives, transfer, sink_grounded)
    return potential


def apply_instrument(voltage: np.ndarray, chosen: list[Setting], frames: Frames) -> np.ndarray:
    """Readings (N, M) V of `voltage` (N, M) V with every instrument effect of `chosen`."""
    for setting in of_stage(chosen, "instrument"):
        voltage = setting.effect.change(voltage, setting, frames)
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
    sensed = sense(
        states, press, skin, channels, chosen, accuracy, frame_s, force_max_N, near, progress
    )
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
    def transfer(self) -> np.ndarray:
        """(K N, n, n) ohm."""
        return self.solve()

    @cached_property
    def with_contact(self) -> np.ndarray:
        """(K N, n + 1, n + 1) ohm: the contact is the last terminal, 0 where there is none."""
        return self.solve(contact=True)

    @property
    def force_N(self) -> np.ndarray:
        """(K N,): the true force, 0 where untouched."""
        return np.where(self.solve.touched, self.solve.touches["force_N"], 0.0)


def sense(
    states: pd.DataFrame,
    press: np.ndarray,
    skin: Skin,
    channels: np.ndarray,
    chosen: list[Setting],
    accuracy: str = "diagnose",
    frame_s: float | None = None,
    force_max_N: float | None = None,
    near: Forward | None = None,
    progress: bool = False,
) -> Sensed:
    """The stages of touch, skin and clock of `simulate`; arguments and errors as there, but for
    those of the skin's solve, which waits until it is asked for."""
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
    history = ForceHistory.of_frames(time_s, force_N, press)
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
        near,
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
    for setting in of_stage(chosen, "clock"):
        seen += setting.effect.force_shift(setting, frames)[:, None] * moment
    seen = np.maximum(seen, 0.0)
    first, last = seen[:, 0], seen[:, -1]
    return replace(frames, seen_N=seen), 0.5 * (first + last), 0.5 * (last - first)


def read(
    sensed: Sensed, current_A: float, chosen: list[Setting], sink_grounded: bool = False
) -> np.ndarray:
    """The stages of wiring and instrument of `simulate`: readings (N, M) V."""
    frames = sensed.frames
    transfer = sensed.with_contact if on_contact(chosen) else sensed.transfer
    channels = frames.channels
    asked = [s for s in of_stage(chosen, "instrument") if not s.effect.on_readings]
    above_sink = None
    if asked or of_stage(chosen, "wiring"):
        drives, drive = _drives(channels)
        potential = apply_wiring(transfer, chosen, drives, sink_grounded, sensed.force_N)[:, drive]
        at = np.arange(len(channels))
        sink, plus, minus = (potential[:, at, channels[:, k]] for k in (1, 2, 3))
        voltage = measurable(plus - minus)
        if asked:
            mean = measurable(0.5 * (plus + minus) - sink)
            above_sink = current_A * _over_frame(mean, sensed)
    else:
        voltage = measurable(channel_values(transfer, channels))
    voltage = current_A * _over_frame(voltage, sensed)
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
    near: Forward | None
    progress: bool

    def __call__(self, contact: bool = False) -> np.ndarray:
        """(N, n, n) ohm: transfer impedance of every row; with `contact`, (N, n + 1, n + 1)."""
        forward, result = self.near, None
        skins = self._skins()
        shown = self.progress and sys.stderr.isatty()
        places = self.touches[["x_mm", "y_mm", "radius_mm"]].to_numpy()
        contrast = self.touches["contrast"].to_numpy()
        for rows in tqdm(skins, unit="skin", disable=not shown):
            geometry = apply_skin(self.base, self.chosen, self._moment(rows[0]))
            forward = forward_model(geometry, self.accuracy, forward)
            value = np.pad(forward.transfer(), (0, int(contact)))
            if result is None:
                result = np.empty((len(self.touches), *value.shape))
            result[rows] = value
            for place, at in _places(places[rows], self.touched[rows]):
                force = contrast[rows[at]]
                if (contact or force.any()) and forward.meets(*place):
                    modes = forward.contact(*place) if contact else forward.place(*place)
                    result[rows[at]] += modes.transfer_change(force)
        return result

    def _skins(self) -> list[np.ndarray]:
        """Rows that share a skin, in order of appearance."""
        drivers = {s.effect.driver for s in of_stage(self.chosen, "skin")} - {"static"}
        if not drivers:
            return [np.arange(len(self.touches))]
        keys = self.touches[["force_N", "x_mm", "y_mm"]] if "force" in drivers else pd.DataFrame()
        if "time" in drivers:
            keys = keys.assign(minutes=self.minutes)
        label = keys.groupby(list(keys), sort=False, dropna=False).ngroup().to_numpy()
        return np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label))[:-1])

    def _moment(self, row: int) -> Moment:
        touch = self.touches.iloc[row]
        force = touch["force_N"] if self.touched[row] else 0.0
        return Moment(self.minutes[row], force, touch["x_mm"], touch["y_mm"])


def _places(places: np.ndarray, touched: np.ndarray) -> list[tuple[tuple, list[int]]]:
    """Places (x, y, radius) of touched rows, in order of appearance, with the rows of each."""
    found: dict[tuple, list[int]] = {}
    for row in np.flatnonzero(touched):
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
    weights = [np.prod([(within - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes]
    return sum(weight * value for weight, value in zip(weights, values, strict=True))
