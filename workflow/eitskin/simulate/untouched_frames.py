"""Untouched frames of a simulated configuration: a new skin and instrument for each session.

Every effect has the same draws as in the configuration's training set, whichever effects are left
out. As there, an untouched frame carries the instrument effects of a touch's force.
"""

import zlib
from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames
from eitskin.effects.settings import site_counts
from eitskin.physics.skin import Skin
from eitskin.simulate.chain import instrument_effects, skin_effects
from eitskin.simulate.readings import apply_instrument, simulate
from eitskin.simulate.sets import NOISE, sample_settings

FORCES = zlib.crc32(b"untouched forces")
UNTOUCHED = pd.DataFrame(
    {"time_s": [0.0], "touch": False, "x_mm": np.nan, "y_mm": np.nan, "force_N": 0.0}
).assign(probe_mm=np.nan)


@dataclass(frozen=True)
class Plan:
    """Sessions, frames in each, the levels force_N (L,) from which each frame's force is drawn,
    the accuracy of the forward model and the seed."""

    sessions: int
    session_frames: int
    force_N: np.ndarray
    accuracy: str
    seed: int


def frames(
    skin: Skin,
    channels: np.ndarray,
    effects: list[dict],
    kept_effects: list[dict],
    noise: float,
    plan: Plan,
) -> np.ndarray:
    """(sessions * session_frames, M) V, session by session, with `kept_effects`, a part of
    `effects`.

    channels (M, 4); noise: standard deviation over the frame's median |v|; force_N (L,): the levels
    from which each frame's force is drawn. Raises InputError as `readings.simulate` does.
    """
    counts = site_counts(channels)
    on_skin, links = skin_effects(effects), instrument_effects(effects)
    ideal = None
    session_frames_V = []
    for session in range(plan.sessions):
        effect_settings = sample_settings(on_skin, counts, (plan.seed, session, 0))
        skin_settings = [
            setting
            for setting, effect in zip(effect_settings, on_skin, strict=True)
            if effect in kept_effects
        ]
        if skin_settings or ideal is None:
            untouched_V = simulate(
                UNTOUCHED, np.array([-1]), skin, channels, skin_settings, plan.accuracy
            )
        if not skin_settings:
            ideal = untouched_V if ideal is None else ideal
            untouched_V = ideal
        voltage = np.repeat(untouched_V, plan.session_frames, axis=0)
        rng = np.random.default_rng((plan.seed, session, FORCES))
        force = rng.choice(plan.force_N, plan.session_frames)
        time_s, largest_N = np.zeros(plan.session_frames), plan.force_N.max()
        state = Frames(time_s, force, channels, force_max_N=largest_N)
        for link, effect in links.items():
            position = int(link.partition("-")[0])
            if effect in kept_effects:
                effect_settings = sample_settings([effect], counts, (plan.seed, session, position))
                voltage = apply_instrument(voltage, effect_settings, state)
        rng = np.random.default_rng((plan.seed, session, NOISE))
        scale = noise * np.median(np.abs(voltage), axis=1, keepdims=True)
        session_frames_V.append(voltage + scale * rng.standard_normal(voltage.shape))
    return np.concatenate(session_frames_V)
