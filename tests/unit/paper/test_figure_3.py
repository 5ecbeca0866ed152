import numpy as np
import pandas as pd
import pytest

from eitskin.data import dataset
from eitskin.data.alignment import homogeneous_readings
from eitskin.errors import InputError
from eitskin.paper import figure_3
from eitskin.physics.geometry import even_angles


@pytest.fixture
def touches(make_recording):
    return dataset.from_recording(make_recording(presses=40), "bench")


def test_they_are_pearson_s(touches):
    table = figure_3.correlations(touches)
    sign = np.sign(homogeneous_readings(np.array(touches.metadata["channels"]), even_angles(16)))
    for target, column in (("x", "x_mm"), ("F", "force_N")):
        r = table[table["target"] == target].set_index("channel")["r"]
        for channel in (0, 6, 100):
            change = sign[channel] * touches.delta_V[:, channel].astype(float)
            expected = np.corrcoef(change, touches.table[column])[0, 1]
            assert r[channel] == pytest.approx(expected, abs=1e-6)
        target_rows = table[table["target"] == target]
        assert target_rows["mean_abs_r"].iloc[0] == pytest.approx(target_rows["r"].abs().mean())


def test_signed_readings_and_magnitudes_tell_the_same(make_recording):
    recorded = make_recording(presses=40)
    signed = figure_3.correlations(dataset.from_recording(recorded, "bench"))
    recorded.voltage = np.abs(recorded.voltage)
    recorded.metadata["voltage"] = "magnitude"
    magnitude = figure_3.correlations(dataset.from_recording(recorded, "bench"))
    np.testing.assert_allclose(signed["r"], magnitude["r"], atol=1e-4)


def test_a_channel_that_never_changes_correlates_with_nothing(touches):
    touches.delta_V[:, 3] = 0.0
    table = figure_3.correlations(touches)
    assert table[table["channel"] == 3]["r"].isna().all()
    assert table["mean_abs_r"].notna().all()


def test_files_are_written_and_hold_both(touches, tmp_path):
    files = [tmp_path / f"figure.{kind}" for kind in ("svg", "png", "csv")]
    simulated = dataset.Dataset(
        touches.table, touches.delta_V, touches.metadata | {"name": "other"}
    )
    figure_3.write(touches, simulated, *files)
    assert all(file.stat().st_size > 1000 for file in files)
    assert set(pd.read_csv(files[2])["dataset"]) == {"bench", "other"}


def test_sets_without_a_common_target_are_refused(touches, tmp_path):
    depth = dataset.Dataset(
        touches.table.assign(depth_mm=np.arange(len(touches.table), dtype=float)),
        touches.delta_V,
        touches.metadata | {"targets": ["depth"]},
    )
    with pytest.raises(InputError, match="found depth, expected one of x, y, F"):
        figure_3.write(depth, touches, *(tmp_path / kind for kind in "abc"))
