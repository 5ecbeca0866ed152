import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from eitskin.simulate import state_priors

NORMAL = st.floats(-4.0, 4.0)


def test_places_are_even_over_the_disc():
    xy = state_priors.place_mm(np.random.default_rng(1).standard_normal((20_000, 2)), 72.0)
    radius, angle = np.hypot(*xy.T), np.arctan2(xy[:, 1], xy[:, 0])
    assert radius.max() < 72.0
    assert stats.kstest((radius / 72.0) ** 2, "uniform").pvalue > 0.01
    assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 0.01


@given(NORMAL, NORMAL)
def test_slope_of_the_place(u, v):
    normal, step = np.array([u, v]), 1e-5 * np.eye(2)
    moved = state_priors.place_mm(normal + step, 72.0) - state_priors.place_mm(normal - step, 72.0)
    assert np.allclose(state_priors.place_slope(normal, 72.0), moved.T / 2e-5, atol=1e-5)


@pytest.mark.parametrize("size", [0.0, 1e-6, 9.9e-3, 1.01e-2, 0.3])
def test_the_series_at_the_centre_joins_the_closed_form(size):
    normal = np.array([0.6, -0.8]) * size
    share = -np.expm1(-0.5 * size**2)
    assert np.hypot(*state_priors.place_mm(normal, 1.0)) == pytest.approx(np.sqrt(share), rel=1e-12)


@given(st.floats(0.0, 71.9), st.floats(-3.14, 3.14))
def test_the_normal_of_a_place_is_its_inverse(radius, angle):
    xy = radius * np.array([np.cos(angle), np.sin(angle)])
    assert np.allclose(
        state_priors.place_mm(state_priors.place_normal(xy, 72.0), 72.0), xy, atol=1e-9
    )


def test_forces_are_clipped():
    assert state_priors.force_N([-9.0, 0.5, 9.0], 5.0, 2.0, 10.0).tolist() == [0.0, 6.0, 10.0]
