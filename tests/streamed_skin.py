"""A skin of 16 electrodes that is quickly learned and streamed: levels and changes of a board's
magnitudes, a tiny predictor of them, exported."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

import synthetic_touches
from eitskin.data import recording, splits
from eitskin.data.baseline import untouched_noise
from eitskin.data.dataset import Dataset
from eitskin.exported.file import Exported
from eitskin.learn import export, train
from eitskin.learn.model_file import Trained
from eitskin.physics.protocol import channel_table

TABLE = channel_table(16)
NOISE_V = 1e-3
PER_CHANGE = 60.0  # of those of `synthetic_touches`: up to 40 mV, many steps of a board
SKIN = dict.fromkeys(
    [
        *("radius_mm", "thickness_mm", "conductivity_S_per_m", "electrode_deg"),
        *("electrode_width_mm", "contact_impedivity_ohm_m2", "current_A", "contrast_per_N"),
    ]
)
RECIPE = train.Recipe(train.Optimiser(2e-3), train.Budget(None, 12), widths=(64, 32))


def level() -> np.ndarray:
    """(208,) V: the untouched skin, reciprocal."""
    electrode_pairs = np.sort(np.stack([TABLE[:, 0], TABLE[:, 2]]), axis=0)
    return (
        0.2
        + 0.3 * np.random.default_rng(5).random((16, 16))[electrode_pairs[0], electrode_pairs[1]]
    )


def readings(states: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """(N, 208) V of states (N, 3) in mm, mm, N; 0 N: untouched."""
    change = PER_CHANGE * synthetic_touches.changes(*states.T)
    return level() + change + NOISE_V * draw.standard_normal(change.shape)


def touches(count: int, draw: np.random.Generator) -> np.ndarray:
    """(N, 3): places within 50 mm of the centre, 2 to 10 N."""
    places = draw.uniform(-50.0, 50.0, (count, 2))
    return np.column_stack([places, draw.uniform(2.0, 10.0, count)])


@cache
def dataset() -> Dataset:
    """4,000 touches with their changes against an untouched frame each."""
    draw = np.random.default_rng(1)
    states = touches(4000, draw)
    nothing = np.zeros_like(states)
    delta = readings(states, draw) - readings(nothing, draw)
    untouched_changes = readings(nothing[:400], draw) - readings(nothing[:400], draw)
    table = pd.DataFrame(
        {
            **{name: np.arange(len(states)) for name in ("sample", "session", "place")},
            **dict(zip(("x_mm", "y_mm", "force_N"), states.T, strict=True)),
            "probe_mm": 10.0,
            "depth_mm": np.nan,
        }
    )
    metadata = {
        "format": "eitskin-dataset",
        "version": 1,
        "name": "streamed",
        "origin": "simulated",
        "configuration": "",
        "targets": ["x", "y", "F"],
        "unit": "V",
        "voltage": "magnitude",
        "position_frame": "skin",
        "channels": TABLE.tolist(),
        "lost_channels": [],
        "untouched": untouched_noise(untouched_changes),
    }
    return Dataset(table, delta.astype(np.float32), metadata)


@cache
def part() -> np.ndarray:
    """Its parts."""
    return splits.assign(dataset().table, "random", 1)


@cache
def trained() -> Trained:
    """A small perceptron of it."""
    return train.train_model(train.Split(dataset(), part()), "mlp", RECIPE, 1)


@cache
def exported() -> Exported:
    """The same as a file's content."""
    return export.export(trained(), dataset(), part(), SKIN, 6, level())


def write_recording(
    path: Path, states: np.ndarray, spoil: object = None, **metadata: object
) -> np.ndarray:
    """A recording of states (N, 3), a frame each 50 ms, its readings (N, 208) changed by `spoil`;
    returns these."""
    voltage = readings(states, np.random.default_rng(3))
    if spoil is not None:
        voltage = spoil(voltage)
    touch = states[:, 2] > 0
    frames = recording.frames_table(0.05 * np.arange(len(states)), touch, *states.T)
    described = recording.metadata_of(TABLE, SKIN, "simulation", "magnitude", frame_s=0.04)
    recording.write(recording.Recording(frames, voltage, None, None, described | metadata), path)
    return voltage
