"""The physical world: a skin pressed by a probe on a robot's tool.

The force is F = k depth^p, with k proportional to the probe and varying smoothly over the skin; the
voltages are those of eitskin's forward model, with the configured effects, for the place, the true
force and its history.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.force_history import ForceHistory
from eitskin.physics.skin import Skin
from eitskin.physics.solver import SolvedSkins
from eitskin.simulate.readings import read, sense, stage_settings

WAVES = 8  # random ones, whose sum varies the stiffness over the skin
TOOL_DOWN_RAD = 0.05  # tolerated lean of the tool, 3 degrees
DRAG_MM = 0.5  # tolerated sideways motion in a press


@dataclass(frozen=True)
class Press:
    """A press as measured by one frame: its place, its probe, and the true force so far.

    x_mm, y_mm on the skin; probe_mm; time_s (K,), force_N (K,): knots, linear between.
    """

    x_mm: float
    y_mm: float
    probe_mm: float
    time_s: np.ndarray
    force_N: np.ndarray

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """The force at times (N,)."""
        return np.interp(time_s, self.time_s, self.force_N, left=0.0, right=0.0)


class World:
    """The skin in the robot's base frame, with its presses, read by channels (M, 4).

    Times are s from the world's beginning; a pose is a TCP pose (6,), m and rotation vector, the
    probe's tip at its origin. With an effect on the reported force, force_N is that on the load
    cell, and the skin has the force after the effect.
    """

    def __init__(self, config: dict, channels: np.ndarray, seed: int):
        self.skin = Skin.from_metadata(config["skin"], "world")
        radius_mm, current_A = self.skin.radius_mm, self.skin.current_A
        if self.skin.rim is not None:
            expected = "a disc: the emulated rig has no other skin"
            raise InputError("world", "skin.outline", "an outline", expected)
        if radius_mm is None or current_A is None:
            raise InputError("world", "skin", "no radius or no current", "every key given")
        self.radius_mm, self.current_A = radius_mm, current_A
        self.channels = channels
        _, first_channel, drive = np.unique(
            channels[:, :2], axis=0, return_index=True, return_inverse=True
        )
        self._drive = first_channel.argsort().argsort()[drive]  # (M,): in the order of driving
        self.effects = settings(config["effects"], site_counts(self.channels), (seed, 0))
        if stage_settings(self.effects, "clock"):
            effect_name = stage_settings(self.effects, "clock")[0].effect.name
            expected = "none of the stage clock: the board reads one channel after another"
            raise InputError("world", "effects", repr(effect_name), expected)
        self.accuracy, self.force_max_N = config["accuracy"], config["force_max_N"]
        self.noise = config["noise"]
        self._solved_skins = SolvedSkins()
        self._is_static = all(s.effect.driver == "static" for s in self.effects)
        self._untouched: np.ndarray | None = None  # (M,) V, where it is always the same
        self._place = config["place"]
        self._stiffness = config["stiffness"]
        self._probe_mm, self._probe_file = config["probe_mm"], config["probe_file"]
        self._readings_rng = np.random.default_rng([seed, 1])
        field = np.random.default_rng([seed, 2])
        length = 2.0 * np.pi / self.radius_mm
        self._waves = field.standard_normal((WAVES, 2)) * length / 2.0
        self._phases = field.uniform(0.0, 2.0 * np.pi, WAVES)
        self.contacts = 0
        self.depth_mm = self.force_N = self.largest_N = 0.0
        self.dragged_mm = 0.0
        self._knots: list[tuple[float, float]] = []
        self._press_place = (0.0, 0.0, 0.0)  # x mm, y mm and probe mm of the last press
        self.touching = False  # whether it goes on
        self.touched_at = np.inf
        self._press_stiffness = 0.0

    def probe_mm(self) -> float:
        """Diameter of the mounted probe: that in the probe file, where there is one."""
        if self._probe_file is not None and Path(self._probe_file).is_file():
            text = Path(self._probe_file).read_text(encoding="utf-8").strip()
            if text:
                return float(text)
        return self._probe_mm

    def on_skin_mm(self, pose: np.ndarray) -> tuple[float, float]:
        """The place (x mm, y mm) of the probe's axis in the skin's frame."""
        place = self._place
        x, y = 1e3 * (pose[0] - place["x_m"]), 1e3 * (pose[1] - place["y_m"])
        turn = np.radians(place["angle_deg"])
        return x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)

    def stiffness(self, x_mm: float, y_mm: float, probe_mm: float) -> float:
        """k in N per mm^p of the gel under a probe."""
        law = self._stiffness
        waves = np.cos(self._waves @ [x_mm, y_mm] + self._phases).sum() * np.sqrt(2.0 / WAVES)
        return law["N_per_mm"] * probe_mm / 10.0 * float(np.exp(law["scatter"] * waves))

    def follow(self, pose: np.ndarray, t: float) -> str | None:
        """Move the probe to `pose` at t s. Returns "touched" or "released" at the begin or end of a
        press."""
        x, y = self.on_skin_mm(pose)
        self.depth_mm = max(1e3 * (self._place["surface_z_m"] - pose[2]), 0.0)
        if not self.touching and self.depth_mm == 0.0:
            return None
        if not self.touching:
            self.touching, self.touched_at = True, t
            self.contacts += 1
            self._press_place = (x, y, self.probe_mm())
            self._press_stiffness = self.stiffness(*self._press_place)
            self._knots = [(t - 1e-6, 0.0)]
        is_first_frame = len(self._knots) == 1
        self.force_N = self._press_stiffness * self.depth_mm ** self._stiffness["exponent"]
        self.largest_N = max(self.largest_N, self.force_N)
        self.dragged_mm = float(np.hypot(x - self._press_place[0], y - self._press_place[1]))
        knots = self._knots
        if len(knots) > 2 and knots[-1][1] == knots[-2][1] == self.force_N:
            knots[-1] = (t, self.force_N)
        elif t > knots[-1][0]:
            knots.append((t, self.force_N))
        if self.depth_mm > 0.0:
            return "touched" if is_first_frame else None
        self.touching, self.touched_at = False, np.inf
        return "released"

    def force_entry(self) -> dict[str, float]:
        """The true force and the largest so far, for the log."""
        return {"force_N": round(self.force_N, 5), "largest_N": round(self.largest_N, 5)}

    def tool_leans(self, pose: np.ndarray) -> bool:
        """Whether the tool does not point straight down."""
        x, y, z = pose[3:]
        angle = np.sqrt(x * x + y * y + z * z)
        if angle == 0.0:
            return True
        # The tool's z axis, by Rodrigues' formula, against base -z.
        cosine = np.cos(angle) + (z / angle) ** 2 * (1.0 - np.cos(angle))
        return cosine > -np.cos(TOOL_DOWN_RAD)

    def press_since(self, start: float, end: float) -> Press | None:
        """The press in a frame from `start` to `end` s, None without one."""
        if self.touching:
            self._knots.append((max(end, self._knots[-1][0] + 1e-6), self.force_N))
        if not self._knots or self._knots[-1][0] < start:
            return None
        time, force = np.array(self._knots).T
        return Press(*self._press_place, time, force)

    def voltages(self, start: float, frame_s: float, press: Press | None) -> np.ndarray:
        """Noise-free signed readings (M,) V of a frame from `start` s on, its drives one after
        another, each at the true force of its time."""
        moments = np.array([start])
        if press is not None:
            n_drives = self._drive.max() + 1
            drives = start + frame_s * np.arange(n_drives) / n_drives
            if np.ptp(press.at(drives)) > 0.0:
                moments = drives
        force = np.zeros(len(moments)) if press is None else press.at(moments)
        touch = force > 0.0
        if self._untouched is not None and not touch.any():
            return self._untouched
        place_and_probe = (
            (np.nan,) * 3 if press is None else (press.x_mm, press.y_mm, press.probe_mm)
        )
        touched = {
            name: np.where(touch, value, np.nan)
            for name, value in zip(("x_mm", "y_mm", "probe_mm"), place_and_probe, strict=True)
        }
        states = pd.DataFrame({"time_s": moments, "touch": touch, "force_N": force, **touched})
        history = None
        if touch.any():
            assert press is not None
            rows = np.flatnonzero(touch)
            history = ForceHistory(moments, (rows,), ((press.time_s, press.force_N),))
        sensed = sense(
            states,
            np.where(touch, 0, -1),
            self.skin,
            self.channels,
            self.effects,
            self.accuracy,
            frame_s,
            self.force_max_N,
            self._solved_skins,
            history=history,
        )
        voltage = read(sensed, self.current_A, self.effects)
        if self._is_static and not touch.any():
            self._untouched = voltage[0]
        if len(moments) == 1:
            return voltage[0]
        return voltage[self._drive, np.arange(len(self.channels))]

    def readings(self, voltage: np.ndarray) -> np.ndarray:
        """Noise-free readings (M,) V with noise."""
        scale = self.noise * np.median(np.abs(voltage))
        return voltage + scale * self._readings_rng.standard_normal(len(voltage))
