"""The force within a press: between frames, before, after; what follows it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from eitskin.physics.force_history import ForceHistory

TIME = np.array([0.0, 2.0, 3.0, 5.0, 6.0, 9.0, 10.0])
FORCE = np.array([0.0, 1.0, 4.0, 2.0, 0.0, 3.0, 0.0])
PRESS = np.array([-1, 0, 0, 0, -1, 1, -1])
HISTORY = ForceHistory.of_frames(TIME, FORCE, PRESS)


def by_hand(t):
    """The first press: knots (1.5, 0), (2, 1), (3, 4), (5, 2), then -1 N/s until 0."""
    return np.maximum(np.interp(t, [1.5, 2.0, 3.0, 5.0, 7.0], [0.0, 1.0, 4.0, 2.0, 0.0]), 0.0)


def test_at_the_frames_it_is_what_was_reported():
    assert np.array_equal(HISTORY.force_N(), FORCE)


@pytest.mark.parametrize("lag", [-2.5, -0.7, -0.2, 0.3, 1.5, 2.4, 5.0])
def test_earlier(lag):
    found = HISTORY.advanced(lag).force_N()
    assert found[1:4] == pytest.approx(by_hand(TIME[1:4] + lag))
    assert found[5] == pytest.approx(max(3.0 + 6.0 * lag, 0.0))
    assert not found[PRESS < 0].any()


def test_raised():
    assert np.allclose(HISTORY.offset(0.5).force_N(), [0, 1.5, 4.5, 2.5, 0, 3.5, 0])
    assert np.allclose(HISTORY.offset(-1.5).force_N(), [0, 0.0, 2.5, 0.5, 0, 1.5, 0])


def test_presses_that_take_turns_have_their_own_frames():
    found = ForceHistory.of_frames(
        np.arange(5.0), np.arange(10.0, 15.0), np.array([1, -1, 0, 1, 0])
    )
    assert [row.tolist() for row in found.rows] == [[2, 4], [0, 3]]
    assert [force.tolist() for _, force in found.knots] == [[0, 12, 14], [0, 10, 13]]
    assert [time[1:].tolist() for time, _ in found.knots] == [[2, 4], [0, 3]]
    untouched = ForceHistory.of_frames(np.arange(2.0), np.zeros(2), np.array([-1, -1]))
    assert untouched.rows == untouched.knots == ()


def test_peak():
    assert np.array_equal(HISTORY.peak_N(), [0, 1, 4, 4, 0, 3, 0])
    assert np.allclose(HISTORY.advanced(1.5).peak_N()[1:4], [by_hand(3.5) + 0.5, 4, 4])


@pytest.mark.parametrize("tau", [0.05, 1.0, 30.0])
@pytest.mark.parametrize("lag", [-0.3, 0.0, 2.6])
def test_what_follows_the_force_against_a_fine_integration(tau, lag):
    found = HISTORY.advanced(lag).relaxed_N(tau)
    solved = solve_ivp(
        lambda t, m: (by_hand(t + lag) - m) / tau,
        (1.5 - lag, 5.0),
        [0.0],
        t_eval=[t for t in TIME[1:4] if t > 1.5 - lag],
        max_step=0.01,
        rtol=1e-9,
        atol=1e-12,
    )
    assert found[1:4] == pytest.approx(solved.y[0], abs=2e-4)


def test_a_held_force_is_followed_exponentially():
    time = np.arange(0.0, 20.0, 0.5)
    history = ForceHistory.of_frames(time, np.full(40, 3.0), np.zeros(40, dtype=int))
    followed = history.relaxed_N(4.0)
    left = 3.0 - followed
    assert left / left[0] == pytest.approx(np.exp(-time / 4.0))


@given(
    st.lists(st.floats(0.0, 10.0), min_size=1, max_size=8),
    st.floats(0.01, 100.0),
    st.floats(-3.0, 3.0),
)
def test_what_follows_stays_between_0_and_the_peak(force, tau, lag):
    n = len(force)
    history = ForceHistory.of_frames(np.arange(n) + 0.0, np.array(force), np.zeros(n, dtype=int))
    later = history.advanced(lag)
    followed, peak = later.relaxed_N(tau), later.peak_N()
    assert (followed >= -1e-12).all() and (followed <= peak + 1e-9).all()
    assert (later.force_N() <= peak + 1e-12).all()
