"""A skin with the effects on it and its instrument: as believed, as a diagnosis has it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin import yaml_file
from eitskin.data import stated
from eitskin.data.recording import Recording, largest_force_N, presses
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.fitting.fit import Fit, fit
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.fitting.simulator import Calibration, RecordingSimulator
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.diagnose.verdict import corrected
from eitskin.effects.effect import Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate

ALIGNMENT = ("robot_scale", "robot_rotation_deg", "robot_x_mm", "robot_y_mm")


@dataclass(frozen=True)
class Simulator:
    """A skin and the effects on it and its instrument.

    effects: entries of a configuration, {name, [electrodes, drives, measures or channels],
    parameters}; factor: the reading for a simulated volt, where the recording's unit is arbitrary;
    drawn: whether random parameters are drawn for every session; alignment: where the recording's
    places are the robot's, the values of ALIGNMENT that map them to the skin's.
    """

    skin: Skin
    effects: Sequence[dict] = ()
    factor: float = 1.0
    drawn: bool = False
    alignment: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def believed(cls, recorded: Recording) -> "Simulator":
        """The skin as its owner states it, with usual values for what is not stated. Raises
        InputError where the scale of the readings, or of the robot's frame, is unknown and none
        can be estimated."""
        model = RecordingSimulator(recorded)
        return cls._of(model, np.zeros(len(model.calibrations)), ())

    @classmethod
    def calibrated(cls, recorded: Recording) -> "Simulator":
        """The skin as its owner states it, calibrated on the recording as in a diagnosis without
        effects. Raises InputError as a diagnosis does."""
        part = excerpt(recorded)
        problem, _ = problem_of(part, estimate_noise(part))
        model = problem.model
        fitted = fit(problem, [], np.zeros(len(model.calibrations)), polish=True)
        return cls.from_fit(fitted)

    @classmethod
    def from_fit(cls, fitted: Fit) -> "Simulator":
        """The skin and the effects of a fit, as `corrected.configuration` writes them."""
        model = fitted.problem.model
        calibration = fitted.theta[: len(model.calibrations)]
        return cls._of(model, calibration, corrected.effect_items(fitted))

    @classmethod
    def _of(
        cls, model: RecordingSimulator, coordinates: np.ndarray, effects: Sequence[dict]
    ) -> "Simulator":
        values, skin = model.calibration_values(coordinates), model.skin(coordinates)
        if model.unit == "ohm":
            skin = replace(skin, current_A=corrected.ONE_AMPERE)
        alignment = {key: values[key] for key in ALIGNMENT if key in values}
        return cls(skin, tuple(effects), values.get("factor", 1.0), alignment=alignment)

    @classmethod
    def read(cls, folder: str | Path) -> "Simulator":
        """The corrected simulator in the folder of a diagnosis, or in its effects.yaml, which
        beside no diagnosis.json is in volts. Raises InputError for other files."""
        path = Path(folder)
        path = path / "effects.yaml" if path.is_dir() else path
        twin = yaml_file.read(path).get("twin")
        if not isinstance(twin, dict) or not {"skin", "effects"} <= twin.keys():
            raise InputError(path, "key twin", "nothing", "the skin and effects of an effects.yaml")
        skin = Skin.from_metadata(dict.fromkeys(stated.SKIN) | twin["skin"], str(path))
        document = path.with_name("diagnosis.json")
        values = {}
        if document.is_file():
            calibration = json.loads(document.read_text("utf-8"))["calibration"]
            values = {key: item["value"] for key, item in calibration.items()}
        alignment = {key: values[key] for key in ALIGNMENT if key in values}
        return cls(skin, twin["effects"], values.get("factor", 1.0), alignment=alignment)

    def model(self, recorded: Recording) -> RecordingSimulator:
        """The simulator of a recording's frames, with nothing to calibrate. Raises InputError for
        touches at the robot's places where no alignment is known."""
        known = {"factor": self.factor}
        if recorded.metadata["position_frame"] == "robot":
            if recorded.frames["touch"].any() and not self.alignment:
                expected = "skin, or a simulator whose alignment a recording or a diagnosis gave"
                raise InputError("recording", "position_frame", "robot", expected)
            known |= self.alignment
        calibrations = [Calibration(key, "", value, 0.0) for key, value in known.items()]
        return RecordingSimulator(recorded, known=(self.skin, calibrations))

    def settings(self, channels: np.ndarray, draw: tuple[int, ...] = (0, 0)) -> list[Setting]:
        """The effects at definite values, for channels (M, 4), random ones by the seed sequence
        `draw`. Raises InputError for unknown names, sites or parameters and values out of bounds.
        """
        return settings(list(self.effects), site_counts(channels), draw)

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """Noise-free signed readings (N, M) of frames with a column `session`, by the recording's
        channels and in its unit; drawn parameters by the seed and the session's number."""
        metadata, readings = recorded.metadata, np.empty((len(states), len(recorded.channels)))
        session_of_frame = np.zeros(len(states)) if not self.drawn else states["session"]
        for session, rows in states.groupby(np.asarray(session_of_frame)).indices.items():
            session_recording = Recording(
                states.iloc[rows].reset_index(drop=True), None, None, None, metadata
            )
            readings[rows] = simulate(
                session_recording.frames,
                presses(session_recording),
                self.skin,
                recorded.channels,
                self.settings(recorded.channels, (seed, int(session))),
                "train",
                frame_s=metadata["frame_s"],
                sink_grounded=metadata["source_reference"] == "sink-grounded",
                force_max_N=largest_force_N(recorded),
            )
        return self.factor * readings
