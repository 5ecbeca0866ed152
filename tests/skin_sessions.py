"""A simulated skin of 8 electrodes, recorded in sessions that differ in what is wrong with it."""

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, frames_table
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from simulated_metadata import simulated_metadata

SKIN = Skin(80.0, 3.0, 0.5, tuple(45.0 * np.arange(8)), 8.0, 2e-3, 1e-3, 0.9)
CHANNELS = channel_table(8)
CONTACT = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 3.0}}
GAIN = {"name": "drive-gain", "drives": [5], "parameters": {"gain": 1.02}}
OPEN = {"name": "electrode-open", "electrodes": [3]}


def recorded(sessions: list[list[dict]], seed: int = 1, presses: int = 5) -> Recording:
    """A recording of sessions a, b, ..., each with effects of its own."""
    draw = np.random.default_rng(seed)
    frames, voltages = [], []
    for k, items in enumerate(sessions):
        force = np.concatenate([np.zeros(4), np.tile([0.0, 2.0, 5.0, 8.0, 4.0], presses)])
        press = np.concatenate([np.full(4, -1), np.repeat(np.arange(presses), 5)])
        press[force == 0] = -1
        turn = np.exp(2j * np.pi * draw.uniform(size=presses))
        place = (60.0 * np.sqrt(draw.uniform(0.02, 1.0, presses)) * turn)[np.maximum(press, 0)]
        time_s = 100.0 * k + 0.5 * np.arange(len(force))
        table = frames_table(time_s, force > 0, place.real, place.imag, force, probe_mm=10.0)
        chosen = settings(items, site_counts(CHANNELS), (0, 0))
        clean = simulate(table, press, SKIN, CHANNELS, chosen, "diagnose")
        noise = 1e-3 * np.median(np.abs(clean)) * draw.normal(size=clean.shape)
        frames.append(table.assign(session="abcdef"[k]))
        voltages.append(clean + noise)
    table = pd.concat(frames, ignore_index=True)
    table["frame"] = np.arange(len(table))
    metadata = simulated_metadata(SKIN, CHANNELS)
    return Recording(table, np.concatenate(voltages), None, None, metadata)
