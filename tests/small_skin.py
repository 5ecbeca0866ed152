"""Simulated recordings of a skin with eight electrodes, small enough to be diagnosed in seconds."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, frames_table, presses
from eitskin.diagnose.fitting import readings
from eitskin.diagnose.fitting.candidates import Candidate, Scales
from eitskin.diagnose.fitting.fit import Fit, Problem, fit
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search.catalogue import Conditions, catalogue
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from simulated_metadata import simulated_metadata

SKIN = Skin(40.0, 3.0, 0.5, tuple(45.0 * np.arange(8)), 5.0, 2e-3, 1e-3, 0.5)
# The same gel and electrodes on an outline, as its owner states it, but for the places.
STATED_ON_OUTLINE = {
    "radius_mm": None,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": None,
    "electrode_width_mm": 5.0,
    "contact_impedivity_ohm_m2": 2e-3,
    "current_A": 1e-3,
    "contrast_per_N": 0.5,
}
CHANNELS = channel_table(8)
METADATA = simulated_metadata(SKIN, CHANNELS)
FORCES_N = (1.0, 4.0, 8.0, 3.0)


def states(places: int = 6, seed: int = 0) -> pd.DataFrame:
    """Frames (N rows): four untouched, then presses at places of their own, each loaded and
    unloaded after an untouched frame."""
    draw = np.random.default_rng(seed)
    force = np.concatenate([np.zeros(4), np.tile([0.0, *FORCES_N], places)])
    press = np.concatenate([np.zeros(4, int), np.repeat(np.arange(places), 1 + len(FORCES_N))])
    radius = 30.0 * np.sqrt(draw.uniform(0.05, 0.9, places))
    place = (radius * np.exp(1j * draw.uniform(0, 2 * np.pi, places)))[press]
    return frames_table(
        2.0 * np.arange(len(force)), force > 0, place.real, place.imag, force, probe_mm=8.0
    )


def voltage(recorded: Recording, items: list[dict]) -> np.ndarray:
    """(N, M): noise-free readings of a recording's skin and states with effects."""
    chosen = settings(items, site_counts(CHANNELS), (0, 0))
    press = presses(recorded)
    return simulate(recorded.frames, press, recorded.skin, CHANNELS, chosen, frame_s=0.2)


def small_recording(
    *items: dict, noise: float = 1e-3, seed: int = 0, places: int = 6, skin: Skin = SKIN
) -> Recording:
    """A recording of effects; noise: over the median reading."""
    metadata = simulated_metadata(skin, CHANNELS)
    recorded = Recording(states(places, seed), None, None, None, metadata)
    clean = voltage(recorded, list(items))
    draw = np.random.default_rng([seed, 1])
    recorded.voltage = clean + noise * np.median(np.abs(clean)) * draw.normal(size=clean.shape)
    return recorded


def problem_of(recorded: Recording, noise: float = 1e-3) -> tuple[Problem, Scales]:
    """The fitting problem, the noise being known: over the median reading."""
    sd = np.full(recorded.voltage.shape[1], noise * np.median(np.abs(recorded.voltage)))
    return readings.problem_of(recorded, NoiseModel(sd, 1e6, "given"))


def candidates_of(
    recorded: Recording, problem: Problem, scales: Scales, timed: bool = True
) -> list[Candidate]:
    """The catalogue of this skin."""
    counts, model = site_counts(CHANNELS), problem.model
    floating = not model.sink_grounded
    conditions = Conditions(recorded.skin, model.nominal_skin, counts, floating, timed)
    return catalogue(conditions, recorded.voltage, scales)


def kinds_of(candidates: list[Candidate]) -> list[Candidate]:
    """One candidate of every name, kind of site, scope and set of starting parameters."""
    first: dict[tuple, Candidate] = {}
    for c in candidates:
        first.setdefault((c.name, c.kind, c.scope, tuple(c.start), c.start.get("harmonic")), c)
    return list(first.values())


def calibrated(problem: Problem) -> Fit:
    """A recording's beliefs, their calibrations fitted."""
    return fit(problem, [], np.zeros(len(problem.model.calibrations)), polish=True)
