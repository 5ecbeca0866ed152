"""The frames of a recording as the simulator has them: touch, skin, wiring, instrument, clock.

Effects are applied stage by stage in that order, whatever their order in the list; within the
instrument in the order of effects.effect.INSTRUMENT_ORDER.
"""

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
from tqdm import tqdm

from eitskin.effects.effect import INSTRUMENT_ORDER, Frames, Moment, Setting
from eitskin.errors import InputError
from eitskin.forward import Forward
from eitskin.geometry import Geometry
from eitskin.skin import Skin

STATE_COLUMNS = ("time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm")


def of_stage(chosen: list[Setting], stage: str) -> list[Setting]:
    """The settings of one stage, in order."""
    return [setting for setting in chosen if setting.effect.stage == stage]


def apply_skin(geometry: Geometry, chosen: list[Setting], moment: Moment) -> Geometry:
    """The geometry at a moment, with every skin effect of `chosen`, in order."""
    for setting in of_stage(chosen, "skin"):
        geometry = setting.effect.change(geometry, setting, moment)
    return geometry


def apply_touch(touches: pd.DataFrame, chosen: list[Setting], frames: Frames) -> pd.DataFrame:
    """Touches with every touch effect of `chosen`: those on the force first, then the rest."""
    ordered = sorted(of_stage(chosen, "touch"), key=lambda s: not s.effect.on_force)
    for setting in ordered:
        touches = setting.effect.change(touches, setting, frames)
    return touches


def apply_instrument(voltage: np.ndarray, chosen: list[Setting], frames: Frames) -> np.ndarray:
    """Readings (N, M) V of `voltage` (N, M) V with every instrument effect of `chosen`."""
    key = INSTRUMENT_ORDER.index
    for setting in sorted(of_stage(chosen, "instrument"), key=lambda s: key(s.effect.order)):
        voltage = setting.effect.change(voltage, setting, frames)
    return voltage


def drive_table(channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drives (D, 2) source, sink, in order of appearance, and the drive (M,) of each channel."""
    drives, first, index = np.unique(channels[:, :2], axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return drives[order], rank[index]


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

    states: STATE_COLUMNS, one row a frame; press (N,) as `recording.presses`. Frames that share a
    skin share its solve; where an effect of the skin follows time, force or place, every frame has
    a skin of its own. `near`: a solved skin, to share with. Raises InputError where `skin` lacks a
    value that a simulation needs.
    """
    for key in ("current_A", "contrast_per_N"):
        if getattr(skin, key) is None:
            raise InputError("skin", key, "null", "a value, to simulate with")
    force = np.nan_to_num(states["force_N"].to_numpy(float))
    frames = Frames(
        states["time_s"].to_numpy(float),
        force,
        press,
        channels,
        frame_s,
        float(force.max(initial=0.0)) if force_max_N is None else force_max_N,
        sink_grounded,
    )
    solver = _Solver(states, skin, chosen, accuracy, near, progress)
    skews = of_stage(chosen, "clock")
    if not skews:
        voltage, above_sink = solver.voltages(frames)
    else:
        shift = sum(s.effect.force_shift(s, frames) for s in skews)
        ends = [
            solver.voltages(replace(frames, force_N=np.maximum(force + part * shift, 0.0)))
            for part in (-0.5, 0.0, 0.5)
        ]
        zeta = np.arange(len(channels)) / max(len(channels) - 1, 1)
        share = 2.0 * (zeta - 0.5)
        weights = (0.5 * share * (share - 1), 1 - share**2, 0.5 * share * (share + 1))
        voltage, above_sink = (
            sum(w * end[k] for w, end in zip(weights, ends, strict=True)) for k in (0, 1)
        )
    frames = replace(frames, above_sink_V=skin.current_A * above_sink)
    return apply_instrument(skin.current_A * voltage, chosen, frames)


class _Solver:
    """Potentials of every frame for given forces, one skin after another."""

    def __init__(self, states, skin: Skin, chosen, accuracy, near, progress: bool):
        self.states, self.skin, self.chosen = states, skin, chosen
        self.accuracy, self.near, self.progress = accuracy, near, progress
        self.base = Geometry.from_skin(skin)
        self.touched = states["touch"].to_numpy(bool)
        drivers = {s.effect.driver for s in of_stage(chosen, "skin")}
        self.each_its_own = bool(drivers - {"static"})

    def voltages(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Readings (N, M) V per A, and the measuring pairs' mean potential above the sink."""
        channels = frames.channels
        drives, drive = drive_table(channels)
        potential = self._potentials(frames, drives)
        at_drive = potential[:, drive]
        rows = np.arange(len(channels))
        plus, minus = at_drive[:, rows, channels[:, 2]], at_drive[:, rows, channels[:, 3]]
        return plus - minus, 0.5 * (plus + minus) - at_drive[:, rows, channels[:, 1]]

    def _potentials(self, frames: Frames, drives: np.ndarray) -> np.ndarray:
        transfer = self._transfers(frames)
        potential = np.swapaxes(transfer[:, :, drives[:, 0]] - transfer[:, :, drives[:, 1]], 1, 2)
        for setting in of_stage(self.chosen, "wiring"):
            potential = setting.effect.change(potential, setting, drives, transfer, frames)
        return potential

    def _transfers(self, frames: Frames) -> np.ndarray:
        """(N, n, n) ohm."""
        table = self._touches(frames)
        n = len(self.base.electrode_deg)
        result = np.empty((len(table), n, n))
        keys = self._moments(frames, table)
        forward = self.near
        groups = pd.Series(np.arange(len(table))).groupby(keys, sort=False).indices
        shown = self.progress and sys.stderr.isatty()
        for rows in tqdm(groups.values(), unit="skin", disable=not shown):
            geometry = apply_skin(self.base, self.chosen, self._moment(frames, table, rows[0]))
            forward = Forward(geometry, self.accuracy, near=forward)
            result[rows] = forward.transfer()
            pressed = table.iloc[rows[self.touched[rows]]]
            for place, touch in pressed.groupby(["x_mm", "y_mm", "radius_mm"], sort=False):
                change = forward.place(*place).transfer_change(touch["contrast"].to_numpy())
                result[touch.index] += change
        return result

    def _touches(self, frames: Frames) -> pd.DataFrame:
        table = pd.DataFrame(
            {
                "x_mm": self.states["x_mm"].to_numpy(float),
                "y_mm": self.states["y_mm"].to_numpy(float),
                "radius_mm": 0.5 * self.states["probe_mm"].to_numpy(float),
                "contrast": self.skin.contrast_per_N * frames.force_N,
                "force_N": frames.force_N,
            }
        )
        return apply_touch(table, self.chosen, frames)

    def _moments(self, frames: Frames, table: pd.DataFrame) -> np.ndarray:
        return np.arange(len(table)) if self.each_its_own else np.zeros(len(table), dtype=int)

    def _moment(self, frames: Frames, table: pd.DataFrame, row: int) -> Moment:
        touch = table.iloc[row]
        minutes = frames.time_s[row] / 60.0
        if not self.touched[row]:
            return Moment(minutes, 0.0, np.nan, np.nan)
        return Moment(minutes, touch["force_N"], touch["x_mm"], touch["y_mm"])
