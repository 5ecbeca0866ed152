"""A recording's simulator: beliefs, calibrations and effects in, readings as recorded out."""

import math
from collections import OrderedDict
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from eitskin.data import alignment, recording
from eitskin.data.recording import Recording
from eitskin.effects.effect import START, Moment, Setting
from eitskin.errors import InputError
from eitskin.physics.depth import span
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin
from eitskin.physics.solver import SolvedSkins
from eitskin.simulate.readings import Sensed, apply_skin, read, sense, stage_settings

# Frames of all the states that were solved last, and bytes, of which those of many channels are
# fewer.
KEPT, KEPT_BYTES = 48_000, 3 << 28
CURRENT_A = 1e-3  # where nobody knows it; the factor is calibrated then
# Where fits start from, and the prior's sd of the logarithm, of what nobody knows.
UNKNOWN = {
    "radius_mm": (80.0, 0.5),
    "thickness_mm": (3.0, 1.0),
    "contact_impedivity_ohm_m2": (2e-3, 1.0),
    "contrast_per_N": (0.5, 2.0),
}
CONDUCTIVITY = (0.5, 0.5)
CONDUCTIVITY_SD = 0.2  # of one that is stated: gels dry and warm
FACTOR_SD = 10.0
MOST = 3.0  # sd by which a calibration may be off
SLIVER = 0.02  # of that: so near a bound, a fit has ended at it


@dataclass(frozen=True)
class Calibration:
    """One value that is fitted and never an effect: start, and the prior's sd about it.

    log: fitted by its logarithm, whose sd it is.
    """

    name: str
    unit: str
    start: float
    sd: float
    log: bool = True

    def value(self, coordinate: float) -> float:
        """The value at a coordinate, 0 being the start, 1 about one sd away, never beyond MOST."""
        coordinate = MOST * math.tanh(coordinate / MOST)
        if self.log:
            return self.start * math.exp(self.sd * coordinate)
        return self.start + self.sd * coordinate

    def at_bound(self, coordinate: float) -> str | None:
        """Whether the value at a coordinate is at the lower bound of what is tried, `low`, or at
        the upper one, `high`; None: at neither."""
        if abs(math.tanh(coordinate / MOST)) < 1.0 - SLIVER:
            return None
        rises = self.start > 0.0 or not self.log
        return "high" if (coordinate > 0.0) == rises else "low"


class RecordingSimulator:
    """Readings (N, M) of the frames of one recording, in its own form and unit, by `voltage`.

    `states` and `channels` are a query's; the recording's by default. Frames whose touch is not
    known well enough to be simulated are not `known` (N,). near: solved skins to share with.
    coarse: bodies are solved at accuracy train.
    """

    coarse = False

    def __init__(
        self,
        recorded: Recording,
        query: Recording | None = None,
        near: SolvedSkins | None = None,
    ):
        frames = recorded if query is None else query
        metadata = recorded.metadata
        self.channels = frames.channels
        self.touched = frames.frames["touch"].to_numpy(bool)
        self.difference = metadata["values"] == "difference"
        self.magnitude = metadata["voltage"] == "magnitude"
        self.unit = metadata["unit"]
        self.frame_s = frames.metadata["frame_s"] or metadata["frame_s"]
        self.sink_grounded = metadata["source_reference"] == "sink-grounded"
        self.press = recording.presses(frames)
        self.force_max_N = float(np.nanmax(recorded.frames["force_N"].fillna(0.0).to_numpy()))
        self.states = _states(frames.frames)
        self.known = ~self.touched | self.states.notna().all(axis=1).to_numpy()
        self.states.loc[~self.known, "touch"] = False
        if not self.known.any():
            found = f"{len(frames.frames)} touches of unknown force or probe"
            raise InputError("recording", "frames", found, "untouched frames, or touches known")
        base = None if query is None else RecordingSimulator(recorded)
        self.believed: Skin
        self.calibrations: list[Calibration]
        self.believed, self.calibrations = (
            (base.believed, base.calibrations) if base else beliefs(recorded)
        )
        self._sensed: OrderedDict[tuple, Sensed] = OrderedDict()
        self._moved = b""
        self.near = near or SolvedSkins()
        if base is None:
            self._start_factor(recorded)

    def _start_factor(self, recorded: Recording) -> None:
        """Where nobody knows the readings' scale, start from that of the median reading; of
        differences, in touched frames. InputError where these have none in a simulation."""
        for i, item in enumerate(self.calibrations):
            if item.name in ("factor", "current_A"):
                rows = np.isfinite(recorded.readings).any(axis=1)
                if self.difference:
                    rows &= self.touched & self.known
                voltage = self.voltage(np.zeros(len(self.calibrations)), [])
                simulated = self._median(voltage[rows]) if rows.any() else 0.0
                if simulated == 0.0:
                    found = "differences of unknown scale that a simulation has at 0"
                    expected = "touches with force, or a known skin.current_A with unit V or ohm"
                    raise InputError("recording", "column voltage_V", found, expected)
                start = item.start * self._median(recorded.readings[rows]) / simulated
                self.calibrations[i] = replace(item, start=start)
                if item.name == "current_A":
                    self.believed = replace(self.believed, current_A=start)
                return

    @property
    def factor(self) -> float:
        """The start of the factor from simulated volts to readings of arbitrary unit, else 1."""
        return next((item.start for item in self.calibrations if item.name == "factor"), 1.0)

    def displaced(self, steps: dict[str, np.ndarray]) -> "RecordingSimulator":
        """The same simulator, states moved by steps (N,) of their columns where touched; no force
        is negative."""
        moved = copy(self)
        own = {key: self.states[key] + np.where(self.touched, s, 0.0) for key, s in steps.items()}
        moved.states = self.states.assign(**own)
        moved.states["force_N"] = moved.states["force_N"].clip(lower=0.0)
        moved._moved = moved.states[["x_mm", "y_mm", "force_N"]].to_numpy().tobytes()
        return moved

    def coarsely(self) -> "RecordingSimulator":
        """The same simulator, bodies solved at accuracy train."""
        moved = copy(self)
        moved.coarse = True
        return moved

    @staticmethod
    def _median(voltage: np.ndarray) -> float:
        return float(np.nanmedian(np.abs(voltage)))

    def calibrated(self, coordinates: np.ndarray) -> dict[str, float]:
        """Values of the calibrations at coordinates (P,)."""
        return {c.name: c.value(u) for c, u in zip(self.calibrations, coordinates, strict=True)}

    def skin(self, coordinates: np.ndarray) -> Skin:
        """The skin at coordinates (P,) of the calibrations."""
        values = self.calibrated(coordinates)
        known: dict[str, Any] = {k: v for k, v in values.items() if hasattr(self.believed, k)}
        if "electrode_rotation_deg" in values:
            turned = np.array(self.believed.electrode_deg) + values["electrode_rotation_deg"]
            known["electrode_deg"] = tuple(turned.tolist())
        return replace(self.believed, **known)

    def geometry(self, coordinates: np.ndarray, chosen: list[Setting]) -> Geometry:
        """The untouched skin's at coordinates (P,) of the calibrations, at the start."""
        return apply_skin(Geometry.from_skin(self.skin(coordinates)), chosen, START)

    def accuracy(self, coordinates: np.ndarray, chosen: list[Setting]) -> str:
        """At which a skin at coordinates (P,) of the calibrations is solved."""
        coarse = self.coarse and span(self.geometry(coordinates, chosen)) is not None
        return "train" if coarse else "diagnose"

    def moments(self, coordinates: np.ndarray, chosen: list[Setting]) -> list[Moment]:
        """(N,): when and how each frame finds its skin, at coordinates (P,) of the calibrations."""
        return self._sense(coordinates, self.skin(coordinates), chosen, True, "diagnose").moments

    def voltage(
        self, coordinates: np.ndarray, chosen: list[Setting], accuracy: str | None = None
    ) -> np.ndarray:
        """(N, M) at coordinates (P,) of the calibrations, with effects at definite values."""
        values = self.calibrated(coordinates)
        skin = self.skin(coordinates)
        accuracy = accuracy or self.accuracy(coordinates, chosen)
        current = 1.0 if self.unit == "ohm" else skin.current_A
        assert current is not None
        sensed = self._sense(coordinates, skin, chosen, True, accuracy)
        signed = read(sensed, current, chosen, self.sink_grounded)
        if self.difference:
            still = self._sense(coordinates, skin, chosen, False, accuracy)
            untouched = read(still, current, chosen, self.sink_grounded)
            signed = signed - untouched
            if self.magnitude:
                signed = signed * np.sign(untouched)
        elif self.magnitude:
            signed = np.abs(signed)
        return values.get("factor", 1.0) * signed

    def _sense(
        self,
        coordinates: np.ndarray,
        skin: Skin,
        chosen: list[Setting],
        touched: bool,
        accuracy: str,
    ) -> Sensed:
        stages = [s for stage in ("touch", "skin", "clock") for s in stage_settings(chosen, stage)]
        key = (
            self._moved,
            touched,
            accuracy,
            *np.asarray(coordinates).tolist(),
            *map(_key, stages),
        )
        if key in self._sensed:
            self._sensed.move_to_end(key)
            return self._sensed[key]
        states = self.states if touched else self.states.assign(touch=False)
        states = _aligned(states, self.calibrated(coordinates))
        sensed = sense(
            states,
            self.press,
            skin,
            self.channels,
            stages,
            accuracy,
            frame_s=self.frame_s,
            force_max_N=self.force_max_N,
            solved_skins=self.near,
        )
        self._sensed[key] = sensed
        frames = KEPT_BYTES // (sensed.nbytes // len(states) + 1)
        while len(self._sensed) * len(states) > min(KEPT, frames) and len(self._sensed) > 1:
            self._sensed.popitem(last=False)
        return sensed


def _key(setting: Setting) -> tuple:
    values = tuple(
        (k, None if v is None else np.asarray(v).tobytes()) for k, v in setting.values.items()
    )
    sites = None if setting.sites is None else setting.sites.tobytes()
    return setting.effect.name, setting.kind, sites, values


def _states(frames: pd.DataFrame) -> pd.DataFrame:
    """Columns that a simulation needs; force 0 and the rest NaN where untouched."""
    columns = ["time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm"]
    states = frames[columns].copy()
    untouched = ~states["touch"].to_numpy(bool)
    states.loc[untouched, "force_N"] = 0.0
    return states.astype({c: float for c in columns if c != "touch"})


def beliefs(recorded: Recording) -> tuple[Skin, list[Calibration]]:
    """The skin with a start for what is unknown, and what is calibrated."""
    skin, metadata = recorded.skin, recorded.metadata
    n = recorded.n_electrodes
    stated = skin.conductivity_S_per_m
    start, sd = CONDUCTIVITY if stated is None else (stated, CONDUCTIVITY_SD)
    found = [Calibration("conductivity_S_per_m", "S/m", start, sd)]
    values: dict[str, Any] = {"conductivity_S_per_m": found[0].start}
    for key, (value, width) in UNKNOWN.items():
        if getattr(skin, key) is None:
            unit = {"radius_mm": "mm", "thickness_mm": "mm", "contrast_per_N": "1/N"}
            values[key] = value
            unneeded = key == "contact_impedivity_ohm_m2" and skin.electrode_width_mm == 0
            if not unneeded and not (key == "contrast_per_N" and not recorded.frames.touch.any()):
                found.append(Calibration(key, unit.get(key, "Ω·m²"), value, width))
    radius = skin.radius_mm or values["radius_mm"]
    if skin.electrode_deg is None:
        values["electrode_deg"] = tuple((np.arange(n) * 360.0 / n).tolist())
        found.append(Calibration("electrode_rotation_deg", "°", 0.0, 180.0 / n, log=False))
    if skin.electrode_width_mm is None:
        values["electrode_width_mm"] = 0.5 * np.pi * radius / n
        found.append(Calibration("electrode_width_mm", "mm", values["electrode_width_mm"], 0.3))
    if skin.current_A is None:
        values["current_A"] = CURRENT_A
        if metadata["unit"] == "V":
            found.append(Calibration("current_A", "A", CURRENT_A, FACTOR_SD))
    if metadata["unit"] == "arbitrary":
        found.append(Calibration("factor", "1", 1.0, FACTOR_SD))
    if metadata["position_frame"] == "robot" and recorded.frames.touch.any():
        similarity = alignment.fit(recorded)
        scale = similarity.scale * (1.0 if skin.radius_mm else radius)
        shift = np.array(similarity.shift) * (1.0 if skin.radius_mm else radius)
        found += [
            Calibration("robot_scale", "1", -scale if similarity.is_mirrored else scale, 0.1),
            Calibration("robot_rotation_deg", "°", similarity.rotation_deg, 10.0, log=False),
            Calibration("robot_x_mm", "mm", float(shift[0]), 0.1 * radius, log=False),
            Calibration("robot_y_mm", "mm", float(shift[1]), 0.1 * radius, log=False),
        ]
    # What is stated of the outline has been judged, and the simulated skin is a disc.
    return replace(skin, **values, outline=None, electrode_xy_mm=None), found


def _aligned(states: pd.DataFrame, values: dict[str, float]) -> pd.DataFrame:
    """States in the skin's frame, where they were the robot's."""
    if "robot_scale" not in values:
        return states
    scale = values["robot_scale"]
    robot = states["x_mm"].to_numpy() + 1j * np.sign(scale) * states["y_mm"].to_numpy()
    turn = abs(scale) * np.exp(1j * np.radians(values["robot_rotation_deg"]))
    skin = turn * robot + complex(values["robot_x_mm"], values["robot_y_mm"])
    return states.assign(x_mm=skin.real, y_mm=skin.imag)
