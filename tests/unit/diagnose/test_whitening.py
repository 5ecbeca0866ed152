"""Whitening against the covariance written out, and against its limit of a free constant."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eitskin.diagnose.whitening import Whitening


def drawn(seed, frames, channels):
    draw = np.random.default_rng(seed)
    voltage = draw.normal(size=(frames, channels))
    voltage[draw.random((frames, channels)) < 0.2] = np.nan
    return voltage, draw.uniform(0.5, 2.0, channels), draw.uniform(0.0, 3.0, channels), draw


def explicit(whitening, a, b, error_sd):
    """a^T C^-1 b, channel by channel, over the frames that are there."""
    total = 0.0
    for m, (sd, error) in enumerate(zip(whitening.sd, error_sd, strict=True)):
        rows = whitening.mask[:, m]
        covariance = sd**2 * np.eye(rows.sum()) + error**2
        total += a[rows, m] @ np.linalg.solve(covariance, b[rows, m])
    return total


@given(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 4))
def test_products_are_those_of_the_inverse_covariance(seed, frames, channels):
    voltage, sd, error, draw = drawn(seed, frames, channels)
    whitening = Whitening.of(voltage, sd, False, error)
    a, b = draw.normal(size=(2, frames, channels))
    found = (whitening(a) * whitening(b)).sum()
    assert np.isclose(found, explicit(whitening, a, b, error), rtol=1e-9, atol=1e-9)
    assert whitening.size == np.isfinite(voltage).sum()
    assert not whitening(a)[~whitening.mask].any()


@given(st.integers(0, 10**6), st.integers(2, 9), st.integers(1, 4))
def test_differences_have_a_free_constant_a_channel(seed, frames, channels):
    voltage, sd, error, draw = drawn(seed, frames, channels)
    whitening = Whitening.of(voltage, sd, True, error)
    a, b = draw.normal(size=(2, frames, channels))
    huge = explicit(whitening, a, b, np.full(channels, 1e4))
    assert np.isclose((whitening(a) * whitening(b)).sum(), huge, rtol=1e-5, atol=1e-5)
    assert np.abs(whitening(np.ones((frames, channels)))).max() < 1e-12
    assert whitening.size == np.isfinite(voltage).sum() - channels


def test_values_of_several_axes_are_whitened_alike():
    voltage, sd, error, draw = drawn(3, 6, 3)
    whitening = Whitening.of(voltage, sd, False, error)
    many = draw.normal(size=(4, 6, 3))
    assert np.allclose(whitening(many), [whitening(one) for one in many])
