import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data import baseline
from eitskin.errors import InputError
from level_recording import level, recording


def test_an_untouched_frame_before_each_press_follows_the_drift():
    touch = np.tile([False, True], 30)
    drift = np.repeat(np.linspace(1, 2, 30), 2)
    voltage = level(*(drift - 0.25 * touch))
    change = baseline.changes(recording(touch, voltage), "drifting")
    np.testing.assert_allclose(change[touch], -0.25, atol=1e-12)


def test_untouched_frames_at_the_start_alone_give_their_mean():
    touch = np.array([False, False, True, True])
    change = baseline.changes(recording(touch, level(1, 3, 5, 6)), "start")
    np.testing.assert_allclose(change[:, 0], [1 - 3, 3 - 1, 5 - 2, 6 - 2])


def test_each_run_of_untouched_frames_serves_the_touches_after_it():
    touch = np.array([True, False, True, False, False, True, False])
    change = baseline.changes(recording(touch, level(9, 1, 2, 3, 5, 8, 7)), "runs")
    # before any run: the next one; the lone first untouched frame has nothing to be compared with
    np.testing.assert_allclose(change[:, 0], [9 - 1, np.nan, 2 - 1, 3 - 1, 5 - 1, 8 - 4, 7 - 4])


def test_a_session_has_its_own_baseline():
    touch = np.array([False, True, False, True])
    voltage = level(1, 2, 10, 12)
    change = baseline.changes(recording(touch, voltage, session=["a", "a", "b", "b"]), "sessions")
    np.testing.assert_allclose(change[touch, 0], [1, 2])
    with pytest.raises(InputError, match=r"two: session 1: found no untouched frame"):
        baseline.changes(recording(touch, voltage, session=["a", "a", "a", "b"]), "two")


def test_lost_readings_of_untouched_frames_are_left_out_of_their_mean():
    touch = np.array([False, False, False, True])
    voltage = level(1, 2, 6, 7)
    voltage[2, 4] = np.nan
    change = baseline.changes(recording(touch, voltage), "lost")
    assert change[3, 4] == pytest.approx(7 - 1.5)
    assert change[3, 5] == pytest.approx(7 - 3)


def test_differences_are_changes_already():
    touch = np.ones(5, bool)
    voltage = level(1, 2, 3, 4, 5)
    change = baseline.changes(recording(touch, voltage, values="difference"), "differences")
    np.testing.assert_array_equal(change, voltage)


def test_a_query_cannot_be_learned_from():
    with pytest.raises(InputError, match="this is a query"):
        baseline.changes(recording(np.ones(5, bool), None), "query")


@given(st.integers(1, 300), st.floats(0.5, 0.999), st.integers(0, 99))
def test_upper_limit_is_a_value_with_at_least_its_share_below(n, share, seed):
    values = np.random.default_rng(seed).normal(size=n)
    limit = baseline.upper_limit(values, share)
    assert limit == values.max() or (values <= limit).sum() >= share * (n + 1)
    assert limit in values
