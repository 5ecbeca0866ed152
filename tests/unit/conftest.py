"""Small recordings: the closed form of a disc with point electrodes, touches to first order."""

import numpy as np
import pandas as pd
import pytest

from eitskin.data.alignment import homogeneous_readings, sensitivity
from eitskin.data.importers.description import describe
from eitskin.data.recording import Recording, frames_table, presses
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

RADIUS_MM = 80.0
FORCES_N = (1.0, 4.0, 8.0, 4.0)


@pytest.fixture
def make_recording():
    """A function that makes a valid recording: untouched repeats, then presses that begin
    untouched, each loaded and unloaded; `channels` (M, 4), `noise` relative to the median reading.
    """

    def make(
        channels: np.ndarray | None = None,
        n_electrodes: int = 16,
        presses: int = 30,
        noise: float = 1e-3,
        seed: int = 0,
    ) -> Recording:
        draw = np.random.default_rng(seed)
        channels = channel_table(n_electrodes) if channels is None else channels
        angles = even_angles(n_electrodes)
        untouched = homogeneous_readings(channels, angles)
        radius = np.sqrt(draw.uniform(0.04, 0.64, presses))
        places = radius * np.exp(2j * np.pi * draw.uniform(size=presses))
        changes = 0.01 * sensitivity(channels, angles, places)
        force = np.concatenate([np.zeros(10), np.tile([0.0, *FORCES_N], presses), np.zeros(5)])
        press = np.concatenate(
            [np.full(10, -1), np.repeat(np.arange(presses), 1 + len(FORCES_N)), np.full(5, -1)]
        )
        touch = force > 0
        at = np.where(touch, press, 0)
        xy = RADIUS_MM * places[at] if presses else np.zeros(len(at), dtype=complex)
        voltage = np.tile(untouched, (len(force), 1))
        if presses:
            voltage += force[:, None] * changes[at]
        voltage += noise * np.median(np.abs(untouched)) * draw.normal(size=voltage.shape)
        frames = frames_table(
            0.5 * np.arange(len(force)), touch, xy.real, xy.imag, force, probe_mm=10.0
        )
        metadata = describe(
            channels,
            angles,
            "simulation",
            "signed",
            unit="V",
            clock="measured",
            skin={"radius_mm": RADIUS_MM, "current_A": 1e-3},
        )
        return Recording(frames, voltage, None, None, metadata)

    return make


@pytest.fixture
def full_recording(make_recording):
    """A recording with every optional column."""
    recording = make_recording(presses=3)
    frames = recording.frames
    touch = frames["touch"].to_numpy()
    frames["session"] = np.where(frames["frame"] < 15, "morning", "evening")
    frames["contact"] = pd.Series(presses(recording), dtype="Int64").where(touch) + 7
    frames["temperature_C"] = 21.5
    frames["note_operator"] = pd.Series(["A"] * len(frames), dtype="str")
    keys = ["x_mm", "y_mm", "force_N", "probe_mm"]
    touches = [
        [{**row, "probe_mm": None}] if touched else None
        for row, touched in zip(frames[keys].to_dict("records"), touch, strict=True)
    ]
    frames["probe_mm"] = np.nan
    recording.quadrature = 0.1 * recording.voltage
    recording.touches = touches
    return recording
