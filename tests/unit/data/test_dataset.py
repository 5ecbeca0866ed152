import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data import dataset
from eitskin.data.recording import ONE_PLACE_MM, Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from synthetic_touches import touches

CHANNELS = channel_table(8)  # 40


def recording(touch, voltage, session=None, x=None, force=None, depth=None, **metadata):
    """A recording of these frames; touches at (x, 0), by default one further place a frame."""
    n = len(touch)
    frames = frames_table(
        np.arange(n) * 0.1,
        touch,
        x_mm=np.arange(n, dtype=float) if x is None else x,
        y_mm=np.zeros(n),
        force_N=force,
        depth_mm=depth,
    )
    if session is not None:
        frames["session"] = session
    given = {"values": "absolute", "unit": "V", "voltage": "signed", "position_frame": "skin"}
    metadata = {**given, "source": "a citation", "channels": CHANNELS.tolist(), **metadata}
    return Recording(frames, voltage, None, None, metadata)


def level(*levels):
    """Frames whose channels all read their level."""
    return np.repeat(np.array(levels, dtype=float)[:, None], len(CHANNELS), axis=1)


def test_an_untouched_frame_before_each_press_follows_the_drift():
    touch = np.tile([False, True], 30)
    drift = np.repeat(np.linspace(1, 2, 30), 2)
    voltage = level(*(drift - 0.25 * touch))
    change = dataset.changes(recording(touch, voltage), "drifting")
    np.testing.assert_allclose(change[touch], -0.25, atol=1e-12)


def test_untouched_frames_at_the_start_alone_give_their_mean():
    touch = np.array([False, False, True, True])
    change = dataset.changes(recording(touch, level(1, 3, 5, 6)), "start")
    np.testing.assert_allclose(change[:, 0], [1 - 3, 3 - 1, 5 - 2, 6 - 2])


def test_each_run_of_untouched_frames_serves_the_touches_after_it():
    touch = np.array([True, False, True, False, False, True, False])
    change = dataset.changes(recording(touch, level(9, 1, 2, 3, 5, 8, 7)), "runs")
    # before any run: the next one; the lone first untouched frame has nothing to be compared with
    np.testing.assert_allclose(change[:, 0], [9 - 1, np.nan, 2 - 1, 3 - 1, 5 - 1, 8 - 4, 7 - 4])


def test_a_session_has_its_own_baseline():
    touch = np.array([False, True, False, True])
    voltage = level(1, 2, 10, 12)
    change = dataset.changes(recording(touch, voltage, session=["a", "a", "b", "b"]), "sessions")
    np.testing.assert_allclose(change[touch, 0], [1, 2])
    with pytest.raises(InputError, match=r"two: session 1: found no untouched frame"):
        dataset.changes(recording(touch, voltage, session=["a", "a", "a", "b"]), "two")


def test_lost_readings_of_untouched_frames_are_left_out_of_their_mean():
    touch = np.array([False, False, False, True])
    voltage = level(1, 2, 6, 7)
    voltage[2, 4] = np.nan
    change = dataset.changes(recording(touch, voltage), "lost")
    assert change[3, 4] == pytest.approx(7 - 1.5)
    assert change[3, 5] == pytest.approx(7 - 3)


def test_differences_are_changes_already():
    touch = np.ones(5, bool)
    voltage = level(1, 2, 3, 4, 5)
    change = dataset.changes(recording(touch, voltage, values="difference"), "differences")
    np.testing.assert_array_equal(change, voltage)


def test_a_query_cannot_be_learned_from():
    with pytest.raises(InputError, match="this is a query"):
        dataset.changes(recording(np.ones(5, bool), None), "query")


def pressed(n=100, **given):
    """A recording untouched and pressed in turn, with noise."""
    touch = np.tile([False, True], n)
    voltage = level(*(1 - 0.25 * touch)) + 0.01 * np.random.default_rng(0).normal(size=(2 * n, 40))
    return touch, voltage, recording(touch, voltage, **given)


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
    one = {"x_mm": 0.0, "y_mm": 0.0, "force_N": 1.0, "probe_mm": 7.0}
    source.touches = [None, [one], *[None, [one, one]] * 2, *[None, [one]] * 97]
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


def test_repeated_positions_are_places():
    xy = np.array([[0.0, 0], [10, 0], [0, 0.3], [10.4, 0], [0, 0]])
    place, rule = dataset.places(xy)
    assert place.tolist() == [0, 1, 0, 1, 0] and "within 1 mm of each other" in rule


@given(st.integers(0, 1000), st.integers(2, 6), st.booleans())
def test_jitter_never_splits_a_place(seed, repeats, all_over):
    """Points on half millimetres, where rounding would tear them apart, or on the edges of blocks;
    all over: so many alone that places are blocks."""
    draw = np.random.default_rng(seed)
    points = draw.permutation(
        np.stack(np.meshgrid(*[np.arange(-20.5, 20, 5)] * 2), -1).reshape(-1, 2)
    )
    again = points[: 10 if all_over else len(points)]
    pressed = np.concatenate([points, *[again] * (1 if all_over else repeats)])
    place, rule = dataset.places(pressed + draw.uniform(-0.02, 0.02, pressed.shape))
    assert ("blocks" in rule) == all_over
    for point in again:
        assert len(set(place[(pressed == point).all(axis=1)])) == 1
    if not all_over:
        assert place.max() + 1 == len(points)


@given(st.integers(0, 100))
def test_so_many_free_positions_that_most_chain_are_still_blocks(seed):
    xy = np.random.default_rng(seed).uniform(-35, 35, (2500, 2))
    place, rule = dataset.places(xy)
    assert "blocks" in rule and place.max() + 1 <= 64


def test_a_skin_swept_over_has_blocks_for_places():
    """Positions that chain into one another from rim to rim leave no place to hold out."""
    sweep = np.stack([np.linspace(-60, 60, 1000), np.repeat(np.arange(4.0), 250)], axis=1)
    place, rule = dataset.places(sweep)
    assert "blocks" in rule and place.max() + 1 == 8


@given(st.integers(0, 1000))
def test_free_positions_are_grouped_into_blocks(seed):
    xy = np.random.default_rng(seed).uniform(-70, 70, (500, 2))
    place, rule = dataset.places(xy)
    assert "blocks" in rule
    assert place.max() + 1 == len(np.unique(place)) <= 64
    side = np.ptp(xy, axis=0).max() / 8
    for k in range(place.max() + 1):
        assert np.ptp(xy[place == k], axis=0).max() <= side + 2 * ONE_PLACE_MM


def test_one_position_pressed_twice_or_all_alone_is_still_a_place():
    assert dataset.places(np.zeros((1, 2)))[0].tolist() == [0]


@given(st.integers(1, 300), st.floats(0.5, 0.999), st.integers(0, 99))
def test_upper_limit_is_a_value_with_at_least_its_share_below(n, share, seed):
    values = np.random.default_rng(seed).normal(size=n)
    limit = dataset.upper_limit(values, share)
    assert limit == values.max() or (values <= limit).sum() >= share * (n + 1)
    assert limit in values


def test_round_trip_is_exact_and_byte_repeatable(tmp_path):
    one = touches(50, seed=1)
    dataset.write(one, tmp_path / "a.parquet")
    dataset.write(touches(50, seed=1), tmp_path / "b.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    two = dataset.read(tmp_path / "a.parquet")
    np.testing.assert_array_equal(two.delta_V, one.delta_V)
    assert two.table.equals(one.table) and two.metadata == one.metadata


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
    one = touches(50, seed=1)
    spoil(one)
    with pytest.raises(InputError, match=message):
        dataset.write(one, tmp_path / "bad.parquet")
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
