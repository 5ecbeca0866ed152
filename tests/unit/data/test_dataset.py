import numpy as np
import pytest

from eitskin.data import dataset
from eitskin.errors import InputError
from level_recording import CHANNELS, level, recording
from synthetic_touches import touches


def pressed(n=100, **columns):
    """A recording untouched and pressed in turn, with noise."""
    touch = np.tile([False, True], n)
    voltage = level(*(1 - 0.25 * touch)) + 0.01 * np.random.default_rng(0).normal(size=(2 * n, 40))
    return touch, voltage, recording(touch, voltage, **columns)


def test_from_recording_keeps_touches_their_states_and_where_they_came_from():
    touch, voltage, source = pressed(depth=np.arange(200) % 3)
    got = dataset.from_recording(source, "pressed")
    assert got.metadata["targets"] == ["x", "depth"]  # y does not vary, force is unknown
    assert (got.table["sample"] == np.flatnonzero(touch)).all()
    np.testing.assert_allclose(got.delta_V, (voltage[1::2] - voltage[::2]).astype(np.float32))
    np.testing.assert_array_equal(got.states()[:, 1], (np.arange(200) % 3)[touch])
    untouched = got.metadata["untouched"]
    assert untouched["frames"] == 99
    assert np.mean(untouched["rms"]) == pytest.approx(0.01 * np.sqrt(2), rel=0.05)


def test_a_channel_often_lost_is_dropped_and_a_frame_seldom_lost_left_out():
    touch, voltage, source = pressed()
    voltage[:, 3] = np.nan
    voltage[touch, 7] = np.where(np.arange(100) < 11, np.nan, voltage[touch, 7])
    voltage[5, 20] = np.nan
    got = dataset.from_recording(source, "losing")
    assert got.metadata["lost_channels"] == [3, 7]
    assert got.metadata["channels"] == np.delete(CHANNELS, [3, 7], axis=0).tolist()
    assert got.metadata["frames_left_out"] == {"reading lost": 1, "several touches": 0}
    assert 5 not in set(got.table["sample"]) and len(got.table) == 99


def test_frames_of_several_touches_are_left_out():
    _, _, source = pressed()
    touch = {"x_mm": 0.0, "y_mm": 0.0, "force_N": 1.0, "probe_mm": 7.0}
    source.touches = [None, [touch], *[None, [touch, touch]] * 2, *[None, [touch]] * 97]
    got = dataset.from_recording(source, "several")
    assert got.metadata["frames_left_out"] == {"reading lost": 0, "several touches": 2}
    assert not {3, 5} & set(got.table["sample"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v, frames: v.fill(np.nan), "every channel lost"),
        (lambda v, frames: frames.__setitem__("touch", False), "no touched frame"),
        (lambda v, frames: frames.__setitem__("x_mm", 1.0), "none known that varies"),
    ],
)
def test_a_recording_with_nothing_to_learn_is_refused(change, message):
    _, voltage, source = pressed()
    change(voltage, source.frames)
    with pytest.raises(InputError, match=message):
        dataset.from_recording(source, "empty")


def test_round_trip_is_exact_and_byte_repeatable(tmp_path):
    touch = touches(50, seed=1)
    dataset.write(touch, tmp_path / "a.parquet")
    dataset.write(touches(50, seed=1), tmp_path / "b.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    two = dataset.read(tmp_path / "a.parquet")
    np.testing.assert_array_equal(two.delta_V, touch.delta_V)
    assert two.table.equals(touch.table) and two.metadata == touch.metadata


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d.metadata.pop("unit"), r"metadata\.unit: found nothing"),
        (lambda d: d.metadata.update(version=2), r"metadata\.format, version: found .* 2"),
        (lambda d: d.metadata.update(targets=["F", "x"]), r"metadata\.targets: found \['F', 'x'\]"),
        (lambda d: d.metadata.update(targets=["depth"]), r"depth_mm, row 0: found no number"),
        (lambda d: d.table.pop("place"), "columns: found"),
        (lambda d: d.table.__setitem__("place", 1.5), "column place: found float64"),
        (lambda d: d.table.__setitem__("sample", 3), "column sample: found repeats"),
        (lambda d: d.delta_V.__setitem__((7, 3), np.nan), "column delta_V, row 7"),
        (lambda d: setattr(d, "delta_V", d.delta_V[1:]), "column delta_V: found float32"),
    ],
)
def test_a_bad_dataset_is_refused_and_nothing_written(tmp_path, spoil, message):
    touch = touches(50, seed=1)
    spoil(touch)
    with pytest.raises(InputError, match=message):
        dataset.write(touch, tmp_path / "bad.parquet")
    assert list(tmp_path.iterdir()) == []


def test_other_files_are_refused(tmp_path):
    dataset.write(touches(50, seed=1), tmp_path / "a.parquet")
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:5000])
    (tmp_path / "text.parquet").write_text("not Parquet")
    for name in ("cut", "text", "absent"):
        with pytest.raises(InputError, match=rf"{name}\.parquet: file: found"):
            dataset.read(tmp_path / f"{name}.parquet")
    touches(5, seed=1).table.to_parquet(tmp_path / "plain.parquet")
    with pytest.raises(InputError, match="no key eitskin-dataset"):
        dataset.read(tmp_path / "plain.parquet")
