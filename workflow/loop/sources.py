"""The simulators that an estimator may learn from, and the sets that they make.

    belief     what the owner believes, its calibrations fitted to the recording, no effect
    authors    belief with the perturbations of a configuration, drawn anew for every session
    diagnosis  the skin and the effects of the diagnosis' effects.yaml, at their values
    truth      the world that the recording is of; only where that is known

All of one seed press the same places with the same forces at the same times, and have the same
noise, that of the recording's own readings (`diagnose.noise`, from the recording alone).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from eitskin.data import dataset
from eitskin.data.dataset import Dataset
from eitskin.data.recording import Recording, presses
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.diagnose.verdict import corrected
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from loop.alike import alike
from witness.world import World

VALIDATED = 5  # every fifth session tells which weights are kept


@dataclass(frozen=True)
class Simulator:
    """A skin with its effects as the configuration has them; `factor`: of its volts, the
    recording's unit; `drawn`: whether parameters change from session to session."""

    skin: Skin
    effects: list[dict]
    factor: float = 1.0
    drawn: bool = False

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """(N, M), noise-free and signed, of the frames of `alike`, in the recording's unit."""
        told, value = recorded.metadata, np.empty((len(states), len(recorded.channels)))
        together = np.zeros(len(states)) if not self.drawn else states["session"]
        for session, rows in states.groupby(np.asarray(together)).indices.items():
            one = Recording(states.iloc[rows].reset_index(drop=True), None, None, None, told)
            value[rows] = simulate(
                one.frames,
                presses(one),
                self.skin,
                recorded.channels,
                settings(self.effects, site_counts(recorded.channels), (seed, int(session))),
                "train",
                frame_s=told["frame_s"],
                sink_grounded=told["source_reference"] == "sink-grounded",
                force_max_N=largest_N(recorded),
            )
        return self.factor * value


@dataclass(frozen=True)
class Truth:
    """The witness' world, with the effects that hold in it."""

    world: World
    effects: list[dict]

    def readings(self, states: pd.DataFrame, recorded: Recording, seed: int) -> np.ndarray:
        """As `Simulator.readings`."""
        value = np.empty((len(states), len(recorded.channels)))
        for rows in states.groupby("session").indices.values():
            one = states.iloc[rows].reset_index(drop=True)
            value[rows] = self.world.readings(one, self.effects, force_max_N=largest_N(recorded))
        return value


def largest_N(recorded: Recording) -> float:
    """The recording's largest force, 0 where none is known."""
    return float(np.nan_to_num(recorded.frames["force_N"].to_numpy(float)).max())


def belief(recorded: Recording) -> Simulator:
    """What the owner believes, calibrated on the recording as the diagnosis begins."""
    seen = excerpt(recorded)
    noise = estimate_noise(seen)
    problem, _ = problem_of(seen, noise)
    fitted = fit(problem, [], np.zeros(len(problem.model.calibrations)), polish=True)
    twin = corrected.corrected(fitted, seen, noise.sd, "belief")["twin"]
    factor = problem.model.calibrated(fitted.theta).get("factor", 1.0)
    return Simulator(Skin.from_metadata(twin["skin"]), [], factor)


def diagnosed(effects: str | Path, diagnosis: dict) -> Simulator:
    """The corrected simulator of effects.yaml; its factor is that of `diagnosis` (diagnosis.json),
    as YAML of a configuration has no key for it."""
    twin = yaml.safe_load(Path(effects).read_text(encoding="utf-8"))["twin"]
    factor = diagnosis["calibration"].get("factor", {"value": 1.0})["value"]
    return Simulator(Skin.from_metadata(twin["skin"], str(effects)), twin["effects"], factor)


def truth(told: dict, recorded: Recording) -> Truth:
    """The world of a truth.json of `loop.case`."""
    metadata = recorded.metadata
    grounded = metadata["source_reference"] == "sink-grounded"
    skin = Skin.from_metadata(told["true"], "truth.json")
    return Truth(World(skin, recorded.channels, metadata["frame_s"], grounded), told["effects"])


def source_set(
    simulator: Simulator | Truth,
    recorded: Recording,
    samples: int,
    seed: int,
    forces: dict,
    probe_mm: float,
    name: str,
) -> tuple[Dataset, np.ndarray]:
    """At least `samples` training samples of a simulator pressed as the recording was, and the
    part (N,) of each: "train" or, of every fifth session, "validation".

    forces, probe_mm: as in `alike`. Raises InputError for a recording of differences.
    """
    if recorded.metadata["values"] == "difference":
        raise InputError("recording", "values", "difference", "absolute, with untouched frames")
    states_rng, noise_rng = (np.random.default_rng([seed, k]) for k in (4, 5))
    touched = int(recorded.frames["touch"].sum())
    sessions = max(VALIDATED, int(np.ceil(samples / touched * VALIDATED / (VALIDATED - 1))) + 1)
    states = alike(recorded, sessions, states_rng, forces, probe_mm)
    sd = estimate_noise(excerpt(recorded)).sd
    voltage = simulator.readings(states, recorded, seed)
    voltage += sd * noise_rng.standard_normal(voltage.shape)
    metadata = recorded.metadata | {"voltage": "signed", "source": "simulation"}
    made = dataset.from_recording(Recording(states, voltage, None, None, metadata), name)
    checked = made.table["session"].to_numpy() % VALIDATED == VALIDATED - 1
    return made, np.where(checked, "validation", "train")
