"""The simulators that are sources of training samples, and the sets drawn from them.

    belief     the nominal skin, its calibrations fitted to the recording, without effects
    authors    belief with the perturbations of a configuration, drawn for every session
    diagnosis  the skin and the effects of the diagnosis' effects.yaml, at their values
    truth      the world of the recording, where it is known

Sets of one seed have the same places, forces and times of presses and the same noise, that of the
recording's readings (`diagnose.noise`, from the recording alone).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from eitskin.data import dataset
from eitskin.data.recording import Recording, presses
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.diagnose.verdict import corrected
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.learn.train import Split
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from loop.imitation import PressPrior, imitated_presses
from witness.world import World

VALIDATION_PERIOD = 5  # every fifth session validates: a fifth of the samples


@dataclass(frozen=True)
class Simulator:
    """A skin with its effects as in a configuration; `factor`: the recording's unit in volt;
    `drawn`: whether random parameters are drawn for every session."""

    skin: Skin
    effects: list[dict]
    factor: float = 1.0
    drawn: bool = False

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """Noise-free signed readings (N, M) of the frames of `imitated_presses`, in the recording's
        unit."""
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
                settings(self.effects, site_counts(recorded.channels), (seed, int(session))),
                "train",
                frame_s=metadata["frame_s"],
                sink_grounded=metadata["source_reference"] == "sink-grounded",
                force_max_N=largest_N(recorded),
            )
        return self.factor * readings


@dataclass(frozen=True)
class Truth:
    """The witness' world with its effects."""

    world: World
    effects: list[dict]

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """Noise-free signed readings (N, M), as `Simulator.readings`."""
        readings = np.empty((len(states), len(recorded.channels)))
        for rows in states.groupby("session").indices.values():
            session_frames = states.iloc[rows].reset_index(drop=True)
            readings[rows] = self.world.readings(
                session_frames, self.effects, force_max_N=largest_N(recorded)
            )
        return readings


def largest_N(recorded: Recording) -> float:
    """The recording's largest force, 0 where none is known."""
    return float(np.nan_to_num(recorded.frames["force_N"].to_numpy(float)).max())


def belief(recorded: Recording) -> Simulator:
    """The simulator of the nominal skin, calibrated on the recording as in a diagnosis without
    effects."""
    recording_excerpt = excerpt(recorded)
    noise = estimate_noise(recording_excerpt)
    problem, _ = problem_of(recording_excerpt, noise)
    fitted = fit(problem, [], np.zeros(len(problem.model.calibrations)), polish=True)
    twin = corrected.configuration(fitted, recording_excerpt, noise.sd, "belief")["twin"]
    factor = problem.model.calibration_values(fitted.theta).get("factor", 1.0)
    return Simulator(Skin.from_metadata(twin["skin"]), [], factor)


def diagnosed(effects: str | Path, diagnosis: dict) -> Simulator:
    """The corrected simulator of effects.yaml, with the factor of `diagnosis` (diagnosis.json), for
    which a configuration has no key."""
    twin = yaml.safe_load(Path(effects).read_text(encoding="utf-8"))["twin"]
    factor = diagnosis["calibration"].get("factor", {"value": 1.0})["value"]
    return Simulator(Skin.from_metadata(twin["skin"], str(effects)), twin["effects"], factor)


def truth(description: dict, recorded: Recording) -> Truth:
    """The world of a truth.json of `loop.case`."""
    metadata = recorded.metadata
    grounded = metadata["source_reference"] == "sink-grounded"
    skin = Skin.from_metadata(description["true"], "truth.json")
    return Truth(
        World(skin, recorded.channels, metadata["frame_s"], grounded), description["effects"]
    )


def source_set(
    simulator: Simulator | Truth,
    recorded: Recording,
    samples: int,
    seed: int,
    prior: PressPrior,
    name: str,
) -> Split:
    """A set of at least `samples` training samples of a simulator with imitated presses; every
    fifth session is the validation part. Raises InputError for a recording of differences."""
    if recorded.metadata["values"] == "difference":
        raise InputError("recording", "values", "difference", "absolute, with untouched frames")
    states_rng, noise_rng = (np.random.default_rng([seed, k]) for k in (4, 5))
    touched = int(recorded.frames["touch"].sum())
    sessions = max(
        VALIDATION_PERIOD,
        int(np.ceil(samples / touched * VALIDATION_PERIOD / (VALIDATION_PERIOD - 1))) + 1,
    )
    states = imitated_presses(recorded, sessions, states_rng, prior)
    sd = estimate_noise(excerpt(recorded)).sd
    voltage = simulator.readings(states, recorded, seed)
    voltage += sd * noise_rng.standard_normal(voltage.shape)
    metadata = recorded.metadata | {"voltage": "signed", "source": "simulation"}
    source_dataset = dataset.from_recording(Recording(states, voltage, None, None, metadata), name)
    is_validation = (
        source_dataset.table["session"].to_numpy() % VALIDATION_PERIOD == VALIDATION_PERIOD - 1
    )
    return Split(source_dataset, np.where(is_validation, "validation", "train"))
