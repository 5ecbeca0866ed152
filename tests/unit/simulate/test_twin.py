"""The simulated twin: a recording like the paper's, and one that says that it is simulated."""

from pathlib import Path

import numpy as np
import yaml

from eitskin.data import recording
from eitskin.simulate import twin

CONFIG = yaml.safe_load((Path(__file__).parents[3] / "config.yaml").read_text())["twin"]


def small(**values):
    press = {**CONFIG["press"], "sessions_per_probe": 1}
    grid = {"radii": 2, "angles": 3, "inner": 0.2, "outer": 0.8}
    blocks = {**CONFIG, "touch_grid": grid, "press": press, "accuracy": "train", **values}
    return twin.Twin(**blocks)


def test_presses_are_the_papers(tmp_path):
    twin.write(tmp_path / "twin.parquet", small())
    read = recording.read(tmp_path / "twin.parquet")
    assert read.metadata["source"] == "simulation"
    frames = read.frames
    label = recording.presses(read)
    assert label.max() + 1 == 6 * 3
    for press in range(label.max() + 1):
        rows = frames[label == press]
        assert (
            np.allclose(np.diff(rows["depth_mm"]), 1.0) and rows["force_N"].is_monotonic_increasing
        )
        assert (rows["force_N"].iloc[:-1] < 10.0).all() and rows["force_N"].iloc[-1] >= 8.0
        before = frames["touch"].to_numpy()[rows.index[0] - 2 : rows.index[0]]
        assert not before.any()
    assert sorted(frames["probe_mm"].dropna().unique()) == [7.0, 10.0, 15.0]
    again = tmp_path / "again.parquet"
    twin.write(again, small())
    assert again.read_bytes() == (tmp_path / "twin.parquet").read_bytes()


def test_noise_is_what_is_asked_for(tmp_path):
    quiet, noisy = tmp_path / "quiet.parquet", tmp_path / "noisy.parquet"
    twin.write(quiet, small(noise=0.0))
    twin.write(noisy, small(noise=0.01))
    a, b = recording.read(quiet).voltage, recording.read(noisy).voltage
    scale = np.median(a, axis=1, keepdims=True)
    assert abs(((b - a) / scale).std() - 0.01) < 3e-4
