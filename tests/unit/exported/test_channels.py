"""Missing channels are what a Gaussian says of them given the others."""

import numpy as np
import pytest

from eitskin.exported.channels import (
    STRENGTHS,
    Channels,
    nan_mean,
    precisions,
    strength,
    strength_edges,
)
from eitskin.exported.electrodes import Electrodes
from eitskin.physics.protocol import channel_table

TABLE = channel_table(12)
M = len(TABLE)
GONE = np.array([1, 4, 5])


@pytest.fixture(scope="module")
def drawn():
    draw = np.random.default_rng(1)
    mixed = draw.normal(size=(4000, 6)) @ draw.normal(size=(6, M))
    return draw.uniform(0.2, 2.0, (4000, 1)) * mixed + 0.1 * draw.normal(size=(4000, M))


@pytest.fixture(scope="module")
def channels(drawn):
    edges = strength_edges(drawn)
    return Channels(precisions(drawn, edges), edges)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(208,), (1, 208), (40, 208)])
@pytest.mark.parametrize("keep", [False, True])
def test_the_mean_of_what_is_there_is_numpy_s_to_the_bit(dtype, shape, keep):
    rng = np.random.default_rng(5)
    x = rng.normal(size=shape).astype(dtype)
    for share in (0.0, 0.1):
        x[rng.random(shape) < share] = np.nan
        mean, numpy_mean = nan_mean(x, (-1,), keep), np.nanmean(x, axis=-1, keepdims=keep)
        assert mean.dtype == numpy_mean.dtype and np.array_equal(mean, numpy_mean)
    assert np.isnan(nan_mean(np.full(3, np.nan), -1))


def test_the_classes_of_strength_are_equally_large(drawn):
    counts = np.bincount(np.searchsorted(strength_edges(drawn), strength(drawn)))
    assert len(counts) == STRENGTHS and (abs(counts - 800) < 5).all()


def test_the_conditional_mean_and_covariance(drawn, channels):
    covariance = np.linalg.inv(channels.precision[2])
    measured = np.delete(np.arange(M), GONE)
    measured_covariance = covariance[np.ix_(measured, measured)]
    gain = covariance[np.ix_(GONE, measured)] @ np.linalg.inv(measured_covariance)
    missing = channels.missing(2, tuple(GONE.tolist()))
    np.testing.assert_allclose(missing.gain, gain, rtol=1e-6, atol=1e-9)
    conditional_covariance = (
        covariance[np.ix_(GONE, GONE)] - gain @ covariance[np.ix_(measured, GONE)]
    )
    root = channels.root(2, tuple(GONE.tolist()), tuple(GONE.tolist()))
    np.testing.assert_allclose(root @ root.T, conditional_covariance, rtol=1e-6, atol=1e-9)


def test_a_pattern_s_amount_is_found_beside_a_touch(drawn, channels):
    pattern = np.random.default_rng(2).normal(size=M)
    gone = tuple(GONE.tolist())
    weights = channels.pattern_weights(pattern, 2, gone)
    amounts = (drawn[:50] + 0.3 * pattern) @ weights
    np.testing.assert_allclose(amounts, 0.3, atol=0.05)
    assert (weights[GONE] == 0.0).all()


def test_one_change_is_filled_as_many_are(drawn, channels):
    lacking = drawn[:50].copy()
    lacking[:, GONE] = np.nan
    together = channels.filled_together(drawn[:50], GONE)
    for change, expected in zip(lacking, together, strict=True):
        filled, missing = channels.filled(change, channels.strength_class(change))
        np.testing.assert_allclose(filled, expected, rtol=1e-9)
        assert list(missing.channels) == GONE.tolist()
    spread = np.std(drawn[:50][:, GONE])
    assert np.abs(together - drawn[:50])[:, GONE].mean() < 0.3 * spread


def test_the_electrode_that_says_something_else_is_the_oddest(drawn, channels):
    electrodes = Electrodes(channels, TABLE)
    for electrode, group in enumerate(electrodes.groups):
        z = drawn[7].copy()
        z[group] += 1.5 * np.random.default_rng(electrode).normal(size=len(group))
        number = channels.strength_class(z)
        assert (
            electrodes.electrode_distances(
                electrodes.precision_weighted(z, number), number
            ).argmax()
            == electrode
        )


def test_a_single_channel_s_distance(drawn, channels):
    electrodes = Electrodes(channels, TABLE)
    covariance, z = np.linalg.inv(channels.precision[1]), drawn[3]
    distances = electrodes.channel_distances(electrodes.precision_weighted(z, 1), 1)
    measured = np.delete(np.arange(M), 8)
    gain = np.linalg.solve(covariance[np.ix_(measured, measured)], covariance[measured, 8])
    squared_distance = (z[8] - gain @ z[measured]) ** 2 / (
        covariance[8, 8] - gain @ covariance[measured, 8]
    )
    assert distances[8] == pytest.approx(squared_distance, rel=1e-6)
