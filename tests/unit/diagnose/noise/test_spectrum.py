"""Noise of any spectrum: its filter against the covariance written out, and what is learned."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.diagnose.noise.lasting_filter import LastingFilter, pulse_norm
from eitskin.diagnose.noise.spectrum import MOST_WAVES, WHITE, Spectrum
from eitskin.diagnose.noise.temporal_correlation import FrameSeries, temporal_correlation

SPECTRA = [
    Spectrum((0.7,), (1.0,)),
    Spectrum((0.9,), (0.4,)),
    Spectrum((0.95, 0.3), (0.5, 0.2)),
    Spectrum((0.99, 0.7, 0.2), (0.3, 0.3, 0.1)),
]
FRAMES, COLUMNS = 240, 60


def lasting(spectrum, seed=0, frames=FRAMES, columns=COLUMNS):
    """(N, C) of unit variance: every process by its recursion, and white noise."""
    rng = np.random.default_rng(seed)
    noise = np.sqrt(spectrum.white_share) * rng.standard_normal((frames, columns))
    for correlation, share in zip(spectrum.correlations, spectrum.shares, strict=True):
        state = rng.standard_normal(columns)
        for row in noise:
            row += np.sqrt(share) * state
            kick = np.sqrt(1.0 - correlation**2)
            state = correlation * state + kick * rng.standard_normal(columns)
    return noise


def learned(noise):
    """Spectrum and drift of series beside their mean."""
    number = np.arange(len(noise))
    constant = np.full((len(noise), 1), len(noise) ** -0.5)
    series = FrameSeries(number, number / number[-1], constant)
    return temporal_correlation(series, noise)[0]


@given(st.sampled_from(SPECTRA), st.integers(0, 10**6), st.integers(2, 12), st.integers(1, 4))
def test_the_filter_is_a_root_of_the_inverse_covariance(spectrum, seed, frames, channels):
    rng = np.random.default_rng(seed)
    mask = rng.random((frames, channels)) > 0.2
    number = np.cumsum(rng.choice([1, 1, 2, 5], frames))
    filtering = LastingFilter.from_mask(mask, number, spectrum)
    values = np.where(mask, rng.standard_normal((3, frames, channels)), 0.0)
    white, log_determinant = filtering.whiten(values), 0.0
    for channel in range(channels):
        rows = mask[:, channel]
        covariance = spectrum.covariance(number[rows])
        expected = values[0, rows, channel] @ np.linalg.solve(covariance, values[1, rows, channel])
        assert np.isclose(white[0, :, channel] @ white[1, :, channel], expected, atol=1e-9)
        log_determinant += np.linalg.slogdet(covariance)[1]
    assert np.isclose(filtering.log_determinant, log_determinant, atol=1e-9)
    assert np.allclose(np.where(mask, filtering.unwhiten(white), 0.0), values)
    other = np.where(mask, rng.standard_normal(values.shape), 0.0)
    assert np.isclose((other * white).sum(), (filtering.whiten_transposed(other) * values).sum())


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_a_pulse_is_as_long_as_the_filter_leaves_it(spectrum):
    number = np.cumsum([1, 1, 2, 1, 5, 1])
    filtering = LastingFilter.from_mask(np.ones((6, 1), bool), number, spectrum)
    lengths = np.linalg.norm(filtering.whiten(np.eye(6)[:, :, None])[..., 0], axis=1)
    assert np.allclose(lengths, pulse_norm(number, spectrum))


@pytest.mark.parametrize(("ratio", "correlation"), [(1.2, 0.8), (0.8, 0.6), (1.0, 0.95)])
def test_noise_that_lasts_is_told_from_the_white_noise_beside_it(ratio, correlation):
    """One process alone would be learned as of a correlation of a third: too short."""
    share = ratio**2 / (1.0 + ratio**2)
    spectrum, drift = learned(lasting(Spectrum((correlation,), (share,))))
    assert drift == 0.0 and len(spectrum.shares) == 1
    assert spectrum.correlations[0] == pytest.approx(correlation, abs=0.04)
    assert spectrum.shares[0] == pytest.approx(share, abs=0.06)


def test_two_timescales_beside_white_noise():
    spectrum, _ = learned(lasting(Spectrum((0.97, 0.5), (0.3, 0.5))))
    assert len(spectrum.shares) == 2
    lags = np.array([1, 3, 10, 30])
    true = Spectrum((0.97, 0.5), (0.3, 0.5)).covariance(np.r_[0, lags])[0, 1:]
    assert spectrum.covariance(np.r_[0, lags])[0, 1:] == pytest.approx(true, abs=0.07)


def test_white_noise_stays_white():
    temporal = [learned(lasting(WHITE, seed, 80, 30)) for seed in range(20)]
    assert sum(bool(spectrum) or drift > 0.0 for spectrum, drift in temporal) <= 1


def test_what_wanders_and_what_is_followed_are_the_whole():
    whole = Spectrum((0.99, 0.5), (0.06, 0.3))
    wander, followed = whole.wander(454.0), whole.followed(454.0)
    assert wander.correlations == (0.99,) and followed.correlations == (0.5,)
    number = np.arange(20)
    total = (1.0 - 0.06) * followed.covariance(number)
    total += wander.covariance(number) - wander.white_share * np.eye(20)
    assert np.allclose(total, whole.covariance(number))
    # What is large and short for waves is followed.
    assert not Spectrum((0.95,), (0.5,)).wander(354.0)


def test_waves_have_the_covariance_of_what_they_stand_for():
    slow, number = Spectrum((0.99,), (0.06,)), np.arange(300)
    waves = slow.waves(number)
    assert len(waves) <= MOST_WAVES
    expected = 0.99 ** np.abs(np.subtract.outer(number, number))
    assert np.abs(waves.T @ waves - expected).max() < 0.12
