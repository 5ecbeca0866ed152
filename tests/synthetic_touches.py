"""A small training set for tests: a fixed smooth map from touches to 208 channels, with noise."""

import numpy as np
import pandas as pd

from eitskin.data.baseline import untouched_noise
from eitskin.data.dataset import Dataset
from eitskin.data.places import places

RADIUS_mm = 70.0
CHANNELS = 208


def changes(x: np.ndarray, y: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Noise-free changes (N, M): a saturating force times smooth waves over the skin."""
    world = np.random.default_rng(1234)  # the skin, the same for every set
    wave = world.normal(0, 2.0, (2, CHANNELS))
    phase = world.uniform(0, 2 * np.pi, CHANNELS)
    xy = np.column_stack([x, y]) / RADIUS_mm
    return 1e-3 * (force / (force + 5.0))[:, None] * np.cos(xy @ wave + phase)


def touches(n: int, seed: int, noise: float = 2e-5, sessions: int = 6) -> Dataset:
    """`n` touches at 48 places, forces 1 to 10 N; channel noise in V."""
    draw = np.random.default_rng(seed)
    at = np.random.default_rng(99).uniform(-RADIUS_mm, RADIUS_mm, (48, 2)).round()
    x, y = at[draw.integers(len(at), size=n)].T
    force = draw.uniform(1, 10, n)
    delta_V = changes(x, y, force) + noise * draw.normal(size=(n, CHANNELS))
    untouched = noise * draw.normal(size=(400, CHANNELS))
    table = pd.DataFrame(
        {
            "sample": np.arange(n),
            "session": np.arange(n) * sessions // n,
            "place": places(np.column_stack([x, y]))[0],
            "x_mm": x,
            "y_mm": y,
            "force_N": force,
            "probe_mm": np.full(n, 16.0),
            "depth_mm": np.full(n, np.nan),
        }
    )
    metadata = {
        "format": "eitskin-dataset",
        "version": 1,
        "name": "waves",
        "origin": "simulated",
        "configuration": "waves",
        "targets": ["x", "y", "F"],
        "unit": "V",
        "untouched": untouched_noise(untouched) if noise else None,
    }
    return Dataset(table, delta_V.astype(np.float32), metadata)
