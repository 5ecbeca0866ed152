"""The simulator of a recording: its skin, calibrations and effects in, readings out."""

import math
from collections import OrderedDict
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from eitskin.data import alignment
from eitskin.data.recording import Recording, has_lengths, largest_force_N, presses, voltages
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.effects.effect import START, Moment, Setting
from eitskin.errors import InputError
from eitskin.physics.depth import span
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import is_plain_disc, is_touchable, laid_out
from eitskin.physics.skin import Skin
from eitskin.physics.solver import SolvedSkins
from eitskin.simulate.readings import Sensed, apply_skin, read, sense, stage_settings

# Frames of all states in the cache, and bytes, which are fewer frames where channels are many.
CACHED_FRAMES, CACHED_BYTES = 48_000, 3 << 28
CURRENT_A = 1e-3  # where it is not stated; the factor is calibrated then
# Starts of fits, and prior sds of the logarithm, of what is not stated.
UNKNOWN = {
    "radius_mm": (80.0, 0.5),
    "thickness_mm": (3.0, 1.0),
    "contact_impedivity_ohm_m2": (2e-3, 1.0),
    "contrast_per_N": (0.5, 2.0),
}
CONDUCTIVITY = (0.5, 0.5)  # the same of the conductivity, S/m
CONDUCTIVITY_SD = 0.2  # of a stated one: gels dry and warm
FACTOR_SD = 10.0  # of a scale's logarithm: any scale
MAX_SD = 3.0  # prior sds that a calibration may be from its start
BOUND_MARGIN = 0.02  # of MAX_SD: a value this close to a bound is at it


@dataclass(frozen=True)
class Calibration:
    """One value that is fitted and never reported as an effect: its start and the prior's sd about
    it, that of the logarithm where `log`."""

    name: str
    unit: str
    start: float
    sd: float
    log: bool = True

    def value(self, coordinate: float) -> float:
        """The value at coordinate u: the start plus sd m tanh(u / m), m = MAX_SD, of the logarithm
        where `log`; 0 is the start, 1 about one sd."""
        coordinate = MAX_SD * math.tanh(coordinate / MAX_SD)
        if self.log:
            return self.start * math.exp(self.sd * coordinate)
        return self.start + self.sd * coordinate

    def at_bound(self, coordinate: float) -> str | None:
        """The bound, low or high, that the value at a coordinate is at; None: neither."""
        if abs(math.tanh(coordinate / MAX_SD)) < 1.0 - BOUND_MARGIN:
            return None
        rises = self.start > 0.0 or not self.log
        return "high" if (coordinate > 0.0) == rises else "low"


@dataclass(frozen=True)
class Member(Calibration):
    """One coordinate of the members of a family, in sds of the family: a value of no bound, of
    which `calibration` of a diagnosis tells nothing."""

    def value(self, coordinate: float) -> float:
        """The coordinate of the family's candidate, in typical changes."""
        return self.sd * coordinate

    def at_bound(self, coordinate: float) -> None:
        """None: a member has no bounds of its own."""


class RecordingSimulator:
    """Simulates the readings (N, M) of a recording's frames.

    base: of a query, the simulator that was fitted, whose skin, calibrations, form, unit and
    largest force it has; solved_skins: a cache to share; known: a skin of which all is known, and
    calibrations that stay at their starts. nominal_skin: the skin as stated, with
    starts for what is not; is_scaleless: whether its radius is a start that nothing tells, and
    stays; calibrations: what is fitted of it, and at last the members of the
    families, each at all its sites; member_derivatives (K, N, M): of the readings by the members'
    coordinates about a fit, which fits near it take as they are; states: those of the frames;
    touched, simulable (N,) bool: whether a frame is touched, and whether its touch is stated well
    enough and clear of the edges of electrodes inside; coarse: whether bodies are solved at
    accuracy train. Raises InputError where no frame can be simulated, or the scale of the readings
    is unknown and none can be estimated.
    """

    coarse = False
    nominal_skin: Skin
    is_scaleless: bool
    calibrations: list[Calibration]
    families: tuple[Candidate, ...] = ()
    member_derivatives: np.ndarray | None = None
    difference: bool
    magnitude: bool
    unit: str
    sink_grounded: bool
    force_max_N: float
    frame_s: float | None

    def __init__(
        self,
        recording: Recording,
        base: "RecordingSimulator | None" = None,
        solved_skins: SolvedSkins | None = None,
        known: tuple[Skin, list[Calibration]] | None = None,
    ):
        metadata = recording.metadata
        self.channels = recording.channels
        self.touched = recording.frames["touch"].to_numpy(bool)
        self.press = presses(recording)
        self.states = _states(recording.frames)
        x_mm, y_mm, probe_mm = self.states[["x_mm", "y_mm", "probe_mm"]].to_numpy().T
        skin = base.nominal_skin if base else recording.skin
        is_stated = self.states.notna().all(axis=1).to_numpy()
        is_clear = is_touchable(skin, x_mm + 1j * y_mm, 0.5 * probe_mm)
        self.simulable = ~self.touched | (is_stated & is_clear)
        self.states.loc[~self.simulable, "touch"] = False
        if not self.simulable.any():
            actual = f"{len(recording.frames)} touches of unknown force or probe"
            raise InputError("recording", "frames", actual, "untouched frames, or touches known")
        self._sensed: OrderedDict[tuple, Sensed] = OrderedDict()
        self._displacement_key = b""
        self.solved_skins = solved_skins or SolvedSkins()
        if base is not None:
            self.nominal_skin, self.calibrations = base.nominal_skin, base.calibrations
            self.coarse, self.is_scaleless = base.coarse, base.is_scaleless
            self.difference, self.magnitude, self.unit = base.difference, base.magnitude, base.unit
            self.sink_grounded, self.force_max_N = base.sink_grounded, base.force_max_N
            self.frame_s = metadata["frame_s"] or base.frame_s
            self.timed: bool = base.timed
            return
        self.difference = metadata["values"] == "difference"
        self.magnitude = metadata["voltage"] == "magnitude"
        self.unit = metadata["unit"]
        self.sink_grounded = metadata["source_reference"] == "sink-grounded"
        self.force_max_N = largest_force_N(recording)
        self.frame_s = metadata["frame_s"]
        self.timed = metadata["clock"] == "measured"
        self.nominal_skin, self.calibrations = known or beliefs(recording)
        self.is_scaleless = known is None and not has_lengths(recording)
        if known is None:
            self._start_factor(recording)

    def _start_factor(self, recording: Recording) -> None:
        """Where the scale of the readings is not stated, start from that of the median reading; of
        differences, in touched frames. Raises InputError where the simulation has them at 0, and
        for a query, which has no readings."""
        for i, item in enumerate(self.calibrations):
            if item.name in ("factor", "current_A"):
                rows = np.isfinite(voltages(recording, "recording")).any(axis=1)
                if self.difference:
                    rows &= self.touched & self.simulable
                voltage = self.voltage(np.zeros(len(self.calibrations)), [])
                simulated = self._median(voltage[rows]) if rows.any() else 0.0
                if simulated == 0.0:
                    actual = "differences of unknown scale that a simulation has at 0"
                    expected = "touches with force, or a known skin.current_A with unit V or ohm"
                    raise InputError("recording", "column voltage_V", actual, expected)
                start = item.start * self._median(recording.readings[rows]) / simulated
                self.calibrations[i] = replace(item, start=start)
                if item.name == "current_A":
                    self.nominal_skin = replace(self.nominal_skin, current_A=start)
                return

    @property
    def factor(self) -> float:
        """The start of the factor from simulated volts to readings of arbitrary unit, else 1."""
        return next((item.start for item in self.calibrations if item.name == "factor"), 1.0)

    def with_displacements(self, steps: dict[str, np.ndarray]) -> "RecordingSimulator":
        """The simulator with touches displaced by steps (N,), by column of the states; no force
        becomes negative."""
        simulator = copy(self)
        columns = {
            key: self.states[key] + np.where(self.touched, step, 0.0) for key, step in steps.items()
        }
        simulator.states = self.states.assign(**columns)
        simulator.states["force_N"] = simulator.states["force_N"].clip(lower=0.0)
        simulator._displacement_key = (
            simulator.states[["x_mm", "y_mm", "force_N"]].to_numpy().tobytes()
        )
        return simulator

    def with_families(self, families: Sequence[tuple[Candidate, float]]) -> "RecordingSimulator":
        """The simulator with the coordinates of families among its calibrations, each with its sd
        in typical changes."""
        simulator = copy(self)
        simulator.families = tuple(candidate for candidate, _ in families)
        simulator.calibrations = [
            *self.calibrations,
            *(
                Member(f"{candidate.name} {number}", "1", 0.0, sd)
                for candidate, sd in families
                for number in range(candidate.size)
            ),
        ]
        return simulator

    def with_families_of(
        self, base: "RecordingSimulator", rows: np.ndarray
    ) -> "RecordingSimulator":
        """The simulator with the families of its base, whose frames (N,) bool it has."""
        simulator = copy(self)
        simulator.families = base.families
        if base.member_derivatives is not None:
            simulator.member_derivatives = base.member_derivatives[:, rows]
        return simulator

    def without_families(self) -> "RecordingSimulator":
        """The simulator without families."""
        simulator = copy(self)
        simulator.families, simulator.member_derivatives = (), None
        simulator.calibrations = [c for c in self.calibrations if not isinstance(c, Member)]
        return simulator

    @property
    def member_columns(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers (K,) of the calibrations that are members of families, and the derivatives
        (K, N, M) of the readings by them; none where these are not known."""
        if self.member_derivatives is None or not self.families:
            return np.zeros(0, int), np.zeros((0, *self.simulable.shape, len(self.channels)))
        count = len(self.member_derivatives)
        return np.arange(len(self.calibrations))[-count:], self.member_derivatives

    def with_member_derivatives(self, derivatives: np.ndarray | None) -> "RecordingSimulator":
        """The simulator with known derivatives (K, N, M) by the members' coordinates, None for
        unknown ones."""
        simulator = copy(self)
        simulator.member_derivatives = derivatives
        return simulator

    @property
    def family_slices(self) -> list[tuple[Candidate, slice]]:
        """The families, each with the slice of the calibrations that its members are."""
        start = len(self.calibrations) - self.member_count
        pairs = []
        for candidate in self.families:
            pairs.append((candidate, slice(start, start + candidate.size)))
            start += candidate.size
        return pairs

    @property
    def member_count(self) -> int:
        """The number of calibrations that are members of families."""
        return sum(candidate.size for candidate in self.families)

    def family_coordinates(self, coordinates: np.ndarray) -> list[tuple[Candidate, np.ndarray]]:
        """The families, each with its candidate's coordinates, at coordinates (P,) of the
        calibrations."""
        pairs = []
        for candidate, members in self.family_slices:
            values = zip(self.calibrations[members], coordinates[members], strict=True)
            pairs.append((candidate, np.array([item.value(u) for item, u in values])))
        return pairs

    def family_settings(self, coordinates: np.ndarray) -> list[Setting]:
        """The families at coordinates (P,) of the calibrations."""
        return [candidate.setting(u) for candidate, u in self.family_coordinates(coordinates)]

    def with_coarse_bodies(self) -> "RecordingSimulator":
        """The simulator with bodies solved at accuracy train; itself where they are."""
        if self.coarse:
            return self
        simulator = copy(self)
        simulator.coarse = True
        return simulator

    @staticmethod
    def _median(voltage: np.ndarray) -> float:
        return float(np.nanmedian(np.abs(voltage)))

    def calibration_values(self, coordinates: np.ndarray) -> dict[str, float]:
        """Values of the calibrations by name at coordinates (P,)."""
        return {c.name: c.value(u) for c, u in zip(self.calibrations, coordinates, strict=True)}

    def skin(self, coordinates: np.ndarray) -> Skin:
        """The nominal skin with the calibrations at coordinates (P,)."""
        values = self.calibration_values(coordinates)
        replaced: dict[str, Any] = {
            k: v for k, v in values.items() if hasattr(self.nominal_skin, k)
        }
        if "electrode_rotation_deg" in values:
            electrode_deg = (
                np.array(self.nominal_skin.electrode_deg) + values["electrode_rotation_deg"]
            )
            replaced["electrode_deg"] = tuple(electrode_deg.tolist())
        return replace(self.nominal_skin, **replaced)

    def geometry(self, coordinates: np.ndarray, settings: list[Setting]) -> Geometry:
        """The geometry of the untouched skin with effects at the recording's start; coordinates
        (P,): of the calibrations."""
        settings = [*self.family_settings(coordinates), *settings]
        return apply_skin(Geometry.from_skin(self.skin(coordinates)), settings, START)

    def accuracy(self, coordinates: np.ndarray, settings: list[Setting]) -> str:
        """The accuracy at which a skin is solved; coordinates (P,): of the calibrations."""
        return "train" if self.coarse and self.is_body(coordinates, settings) else "diagnose"

    def is_body(self, coordinates: np.ndarray, settings: list[Setting]) -> bool:
        """Whether the skin is a body; coordinates (P,): of the calibrations."""
        return span(self.geometry(coordinates, settings)) is not None

    def moments(self, coordinates: np.ndarray, settings: list[Setting]) -> list[Moment]:
        """(N,): time and touch of every frame with effects; coordinates (P,): of the
        calibrations."""
        settings = [*self.family_settings(coordinates), *settings]
        return self._sense(coordinates, self.skin(coordinates), settings, True, "diagnose").moments

    def voltage(
        self, coordinates: np.ndarray, settings: list[Setting], accuracy: str | None = None
    ) -> np.ndarray:
        """(N, M): readings at coordinates (P,) of the calibrations, with effects at definite
        values. Raises InputError where the physics has no solution."""
        values = self.calibration_values(coordinates)
        skin = self.skin(coordinates)
        accuracy = accuracy or self.accuracy(coordinates, settings)
        settings = [*self.family_settings(coordinates), *settings]
        current = 1.0 if self.unit == "ohm" else skin.current_A
        assert current is not None
        sensed = self._sense(coordinates, skin, settings, True, accuracy)
        signed = read(sensed, current, settings, self.sink_grounded)
        if self.difference:
            sensed_untouched = self._sense(coordinates, skin, settings, False, accuracy)
            untouched = read(sensed_untouched, current, settings, self.sink_grounded)
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
        settings: list[Setting],
        touched: bool,
        accuracy: str,
    ) -> Sensed:
        stages = [
            s for stage in ("touch", "skin", "clock") for s in stage_settings(settings, stage)
        ]
        key = (
            self._displacement_key,
            touched,
            accuracy,
            *np.asarray(coordinates).tolist()[: len(self.calibrations) - self.member_count],
            *map(_key, stages),
        )
        if key in self._sensed:
            self._sensed.move_to_end(key)
            return self._sensed[key]
        states = self.states if touched else self.states.assign(touch=False)
        states = _aligned(states, self.calibration_values(coordinates))
        sensed = sense(
            states,
            self.press,
            skin,
            self.channels,
            stages,
            accuracy,
            frame_s=self.frame_s,
            force_max_N=self.force_max_N,
            solved_skins=self.solved_skins,
        )
        self._sensed[key] = sensed
        frames = CACHED_BYTES // (sensed.nbytes // len(states) + 1)
        while (
            len(self._sensed) * len(states) > min(CACHED_FRAMES, frames) and len(self._sensed) > 1
        ):
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


def beliefs(recording: Recording) -> tuple[Skin, list[Calibration]]:
    """The skin as stated, with starts for what is not, and the calibrations."""
    skin, metadata = laid_out(recording.skin), recording.metadata
    n = recording.n_electrodes
    stated_conductivity = skin.conductivity_S_per_m
    start, sd = CONDUCTIVITY
    if stated_conductivity is not None:
        start, sd = stated_conductivity, CONDUCTIVITY_SD
    calibrations = [Calibration("conductivity_S_per_m", "S/m", start, sd)]
    values: dict[str, Any] = {"conductivity_S_per_m": calibrations[0].start}
    for key, (value, width) in UNKNOWN.items():
        if getattr(skin, key) is None:
            unit = {"radius_mm": "mm", "thickness_mm": "mm", "contrast_per_N": "1/N"}
            values[key] = value
            unneeded = key == "contact_impedivity_ohm_m2" and skin.electrode_width_mm == 0
            unneeded |= key == "radius_mm" and not has_lengths(recording)
            if not unneeded and not (key == "contrast_per_N" and not recording.frames.touch.any()):
                calibrations.append(Calibration(key, unit.get(key, "Ω·m²"), value, width))
    radius = skin.radius_mm or values["radius_mm"]
    if skin.electrode_deg is None:
        values["electrode_deg"] = tuple((np.arange(n) * 360.0 / n).tolist())
        calibrations.append(Calibration("electrode_rotation_deg", "°", 0.0, 180.0 / n, log=False))
    if skin.electrode_width_mm is None:
        width_mm = 0.5 * np.pi * radius / n
        values["electrode_width_mm"] = width_mm
        calibrations.append(Calibration("electrode_width_mm", "mm", width_mm, 0.3))
    if skin.current_A is None:
        values["current_A"] = CURRENT_A
        if metadata["unit"] == "V":
            calibrations.append(Calibration("current_A", "A", CURRENT_A, FACTOR_SD))
    if metadata["unit"] == "arbitrary":
        calibrations.append(Calibration("factor", "1", 1.0, FACTOR_SD))
    if metadata["position_frame"] == "robot" and recording.frames.touch.any():
        if not is_plain_disc(skin):
            actual = "robot, on a skin that is no disc, or has electrodes inside"
            raise InputError("recording", "position_frame", actual, "places in the skin's frame")
        similarity = alignment.fit(recording)
        scale = similarity.scale * (1.0 if skin.radius_mm else radius)
        shift = np.array(similarity.shift) * (1.0 if skin.radius_mm else radius)
        calibrations += [
            Calibration("robot_scale", "1", -scale if similarity.is_mirrored else scale, 0.1),
            Calibration("robot_rotation_deg", "°", similarity.rotation_deg, 10.0, log=False),
            Calibration("robot_x_mm", "mm", float(shift[0]), 0.1 * radius, log=False),
            Calibration("robot_y_mm", "mm", float(shift[1]), 0.1 * radius, log=False),
        ]
    return replace(skin, **values), calibrations


def _aligned(states: pd.DataFrame, values: dict[str, float]) -> pd.DataFrame:
    """States in the skin's frame, where they were the robot's."""
    if "robot_scale" not in values:
        return states
    scale = values["robot_scale"]
    robot = states["x_mm"].to_numpy() + 1j * np.sign(scale) * states["y_mm"].to_numpy()
    turn = abs(scale) * np.exp(1j * np.radians(values["robot_rotation_deg"]))
    skin = turn * robot + complex(values["robot_x_mm"], values["robot_y_mm"])
    return states.assign(x_mm=skin.real, y_mm=skin.imag)
