"""Ratios and logarithms of modified Bessel functions against scipy's."""

import numpy as np
from scipy.special import iv, kv

from eitskin.physics.bessel_ratios import inner_steps, log_inner, outer_steps

K = np.array([1e-2, 0.7, 5.0, 40.0])
ORDER = np.arange(21)[:, None]


def test_steps_and_logarithms():
    inner, outer = inner_steps(40, K), outer_steps(20, K)
    np.testing.assert_allclose(inner[:21], K * iv(ORDER + 1, K) / iv(ORDER, K), rtol=1e-12)
    np.testing.assert_allclose(outer, K * kv(ORDER + 1, K) / kv(ORDER, K), rtol=1e-12)
    np.testing.assert_allclose(log_inner(K, inner[:21]), np.log(iv(ORDER, K)), rtol=1e-11)


def test_orders_far_beyond_the_range_of_floats():
    inner = inner_steps(800, K)
    assert np.isfinite(log_inner(K, inner)).all() and np.isfinite(outer_steps(800, K)).all()
    assert log_inner(K, inner)[-1].max() < -2000.0
