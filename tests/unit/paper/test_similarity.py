import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from scipy.stats import wasserstein_distance

from eitskin.paper import similarity
from eitskin.paper.similarity import MEASURES, Pool


def of(frames, size):
    return similarity.mmd(cdist(frames, frames, "sqeuclidean"), size)


def test_mmd_of_two_far_points_is_two_less_twice_the_kernel_at_the_median():
    frames = np.repeat([[0.0], [1000.0]], 20, axis=0)
    assert of(frames, 20) == pytest.approx(2.0 - 2.0 * np.exp(-0.5))


def test_mmd_is_zero_for_equal_sets_and_for_frames_that_are_all_the_same():
    sample = np.random.default_rng(0).standard_normal((30, 5))
    assert of(np.concatenate([sample, sample]), 30) == pytest.approx(0.0, abs=1e-12)
    assert of(np.ones((6, 2)), 3) == 0.0


def test_mmd_terms_make_the_mmd():
    frames = np.random.default_rng(1).standard_normal((40, 3))
    squared = cdist(frames, frames, "sqeuclidean")
    within, within_other, across = similarity.mmd_terms(squared, 10)
    assert similarity.mmd(squared, 10) == pytest.approx(within + within_other - 2.0 * across)
    assert within > across


def test_coral_of_frames_twice_as_wide_is_three_covariances():
    frames = np.random.default_rng(2).standard_normal((50, 4))
    covariance = np.cov(frames, rowvar=False)
    shrunk = 0.999 * covariance + 0.001 * np.trace(covariance) / 4 * np.eye(4)
    assert similarity.coral(2.0 * frames, frames) == pytest.approx(3.0 * np.linalg.norm(shrunk))


def test_coral_does_not_see_a_shift():
    frames = np.random.default_rng(3).standard_normal((50, 4))
    assert similarity.coral(frames + 7.0, frames) == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=30)
@given(
    shift=st.integers(0, 20),
    gain=st.floats(0.1, 10.0),
    offset=st.floats(-5.0, 5.0),
    seed=st.integers(0, 99),
)
def test_ncc_is_one_whatever_the_shift_the_gain_and_the_offset(shift, gain, offset, seed):
    frame = np.random.default_rng(seed).standard_normal(21)
    assert similarity.ncc(gain * np.roll(frame, shift) + offset, frame) == pytest.approx(1.0)


def test_ncc_is_the_largest_of_all_correlations():
    a, b = np.random.default_rng(4).standard_normal((2, 13))
    best = max(np.corrcoef(a, np.roll(b, k))[0, 1] for k in range(13))
    assert similarity.ncc(a, b) == pytest.approx(best)
    assert np.isnan(similarity.ncc(np.ones(13), b))


@settings(max_examples=20)
@given(n=st.integers(1, 12), m=st.integers(1, 12), seed=st.integers(0, 99))
def test_swd_is_the_mean_of_scipy_s_distances(n, m, seed):
    draw = np.random.default_rng(seed)
    a, b = draw.standard_normal((n, 3)), draw.standard_normal((m, 3))
    expected = np.mean([wasserstein_distance(a[:, k], b[:, k]) for k in range(3)])
    assert similarity.swd(a, b) == pytest.approx(expected)


def test_directions_are_unit_vectors_and_the_seed_s():
    directions = similarity.directions(7, 1)
    assert directions.shape == (7, 64)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=0), 1.0)
    np.testing.assert_array_equal(directions, similarity.directions(7, 1))
    assert not np.array_equal(directions, similarity.directions(7, 2))


def pool(shift, spread, seed=0, sessions=20):
    """A recording of 60 frames, then sessions of 3 frames: plain ones, and others that each have
    an offset of their own of size `spread` besides `shift`."""
    draw = np.random.default_rng(seed)
    base = np.linspace(1.0, 2.0, 12)
    real = base + 0.1 * draw.standard_normal((60, 12))
    plain = base + 0.1 * draw.standard_normal((3 * sessions, 12))
    session_means = np.repeat(spread * draw.standard_normal((sessions, 12)), 3, axis=0)
    shifted = base + shift + session_means + 0.1 * draw.standard_normal((3 * sessions, 12))
    rows = 60 + np.arange(6 * sessions).reshape(2, sessions, 3)
    return Pool(np.concatenate([real, plain, shifted]), np.arange(60), seed), *rows


def noticed(pooled, plain, shifted):
    change, permuted = pooled.changes(shifted, plain, 99, np.random.default_rng(1))
    low, high = np.quantile(permuted, [0.025, 0.975], axis=0)
    return dict(zip(MEASURES, (change < low) | (change > high), strict=True))


def test_a_shift_of_every_channel_is_noticed_but_not_by_what_cannot_see_it():
    measures = noticed(*pool(shift=0.2, spread=0.0))
    assert measures["mmd"] and measures["swd"]
    assert not measures["coral"]


def test_a_spread_between_sessions_is_noticed_by_the_covariance():
    assert noticed(*pool(shift=0.0, spread=0.3))["coral"]


@pytest.mark.long
def test_nothing_is_noticed_more_often_than_the_level_says():
    """40 worlds in which nothing differs: each measure cries in 5 % of them; 16 % is three
    standard deviations."""
    cries = [noticed(*pool(0.0, 0.0, seed, sessions=8)) for seed in range(40)]
    for measure in MEASURES:
        assert np.mean([cry[measure] for cry in cries]) < 0.16, measure


@pytest.mark.long
def test_sessions_change_sides_as_a_whole():
    """Where frames of a session are alike, exchanging frames one by one would cry at nothing."""
    cries = []
    for seed in range(25):
        draw = np.random.default_rng(seed)
        real = draw.standard_normal((40, 6))
        frames_of_sides = np.repeat(draw.standard_normal((2, 6, 6)), 10, axis=1)
        pooled = Pool(np.concatenate([real, *frames_of_sides]), np.arange(40), seed)
        rows = 40 + np.arange(120).reshape(2, 6, 10)
        cries.append(noticed(pooled, *rows)["mmd"])
    assert np.mean(cries) < 0.2


def test_halves_of_a_recording_are_near_to_each_other():
    pooled, _, shifted = pool(shift=1.0, spread=0.0)
    halves = pooled.halves(40, np.random.default_rng(0))
    assert halves.shape == (40, 4)
    distances = pooled.compare(shifted.ravel(), pooled.real)
    assert distances[0] > halves[:, 0].max() and distances[3] > halves[:, 3].max()
