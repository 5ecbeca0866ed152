"""Noise refined after a first fit, on readings that are made up: every kind found, and none where
there is none, whatever the skin does that the fit does not know."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitskin.data.recording import Recording
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.diagnose.noise.refinement import refine_noise
from eitskin.physics.protocol import channel_table

FRAMES, SD = 90, 1e-3
CHANNELS = channel_table(12)
ODD, EVEN = parity(CHANNELS)
ONE_OF_EACH = np.unique(np.abs(EVEN).argmax(axis=0))


def simulated(seed=0):
    """Readings about 1 that reciprocity ties, three touches in turn; (N, M)."""
    rng = np.random.default_rng(seed)
    level, touched = rng.uniform(0.3, 2.0, EVEN.shape[1]), rng.normal(size=(3, EVEN.shape[1]))
    force = np.zeros((FRAMES, 3))
    for touch in range(3):
        force[10 + 28 * touch :][:18, touch] = 0.05 * np.sin(np.linspace(0.2, 3.0, 18))
    return (level + force @ touched) @ EVEN.T


def white(seed=1, count=None):
    return np.random.default_rng(seed).normal(size=(FRAMES, count or len(CHANNELS)))


def correlated(rho, seed=1):
    noise = white(seed)
    for row in range(1, FRAMES):
        noise[row] = rho * noise[row - 1] + np.sqrt(1.0 - rho**2) * noise[row]
    return noise


def misfit(seed=2):
    """What a skin does that the fit does not know: ten sd, in the even half alone."""
    rng = np.random.default_rng(seed)
    course = np.repeat(rng.normal(size=(FRAMES // 3, 4)), 3, axis=0)
    return SD * 10.0 * course @ rng.normal(size=(4, EVEN.shape[1])) @ EVEN.T


def recording(readings, channels=CHANNELS, number=None, **metadata):
    time = np.arange(len(readings), dtype=float)
    frames = pd.DataFrame({"time_s": time, "touch": np.arange(len(readings)) % 2 == 1})
    frames["frame"] = np.arange(len(readings)) if number is None else number
    given = {"values": "absolute", "voltage": "signed", "channels": channels.tolist()}
    return Recording(frames, readings, None, None, given | metadata)


def lag_one(model):
    """Correlation from one frame to the next of all that lasts."""
    slow = sum(model.wander.shares)
    return (1.0 - slow) * model.spectrum.lag_one + model.wander.lag_one


def noise(sd=SD, channels=CHANNELS):
    return NoiseModel(np.full(len(channels), sd), 1e4, "given")


def refined(voltage, before=None, shown=None, **metadata):
    shown = simulated() if shown is None else shown
    return refine_noise(recording(voltage, **metadata), before or noise(), shown)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("beside", [0.0, 1.0])
def test_plain_noise_is_left_alone(seed, beside):
    before = noise()
    found = refined(simulated() + SD * white(seed) + beside * misfit(seed), before)
    assert found is before


def test_an_instrument_s_faults_are_not_noise():
    gains = 1.0 + 0.1 * np.random.default_rng(12).normal(size=len(CHANNELS))
    assert refined(gains * simulated() + SD * white(), before := noise()) is before
    hum = np.random.default_rng(13).normal(size=(len(CHANNELS), 2)) * SD
    phase = 0.3 * np.arange(FRAMES)
    hum = np.column_stack([np.sin(phase), np.cos(phase)]) @ hum.T
    found = refined(simulated() + SD * correlated(0.6) + hum, noise(0.5 * SD))
    assert lag_one(found) == pytest.approx(0.6, abs=0.04)
    assert found.drift == 0.0


def test_a_level_that_is_wrong_is_put_right():
    found = refined(simulated() + SD * white() + misfit(), noise(0.3 * SD))
    assert found.sd == pytest.approx(SD, rel=0.05)
    assert (
        not found.spectrum and found.drift == found.spike_count == 0 and found.rejected_mask is None
    )


@pytest.mark.parametrize("rho", [0.3, 0.6, 0.9, 0.96])
def test_correlated_noise(rho):
    found = refined(simulated() + SD * correlated(rho) + misfit(), noise(0.3 * SD))
    assert 1.0 - lag_one(found) == pytest.approx(1.0 - rho, rel=0.15)
    assert found.sd == pytest.approx(SD, rel=0.12)
    assert found.drift == 0.0 and found.spike_count == 0 and found.loud_frames == ()
    assert f"frame to frame, {lag_one(found):.2g}" in found.source
    assert 0.5 * ODD.size * FRAMES / len(ODD) < found.dof < ODD.shape[1] * FRAMES


@pytest.mark.parametrize(("rho", "gap"), [(0.6, 12), (0.9, 12), (0.995, 60)])
def test_correlated_noise_of_an_excerpt(rho, gap):
    """Six frames of every press in a row, after a frame so far from the others."""
    number = np.cumsum(np.where(np.arange(FRAMES) % 7 < 2, gap, 1))
    kept = rho ** np.append(np.inf, np.diff(number))[:, None]
    own = white()
    for row in range(1, FRAMES):
        own[row] = kept[row] * own[row - 1] + np.sqrt(1.0 - kept[row] ** 2) * own[row]
    found = refined(simulated() + SD * own + misfit(), noise(0.3 * SD), number=number)
    assert 1.0 - lag_one(found) == pytest.approx(1.0 - rho, rel=0.15)
    assert found.sd == pytest.approx(SD, rel=0.15)
    assert found.drift == 0.0


def test_correlated_noise_of_thinned_frames():
    """None of them next to another: what is left after twenty is told of one."""
    found = refined(simulated() + SD * correlated(0.9), number=20 * np.arange(FRAMES))
    assert found.spectrum.lag_one**20 == pytest.approx(0.9, abs=0.02)


def test_drift_of_each_channel_of_its_own():
    walk = np.cumsum(white(3), axis=0) / np.sqrt(FRAMES)
    found = refined(simulated() + SD * (white() + 2.0 * walk) + misfit())
    assert found.drift == pytest.approx(2.0, rel=0.15)
    assert lag_one(found) == 0.0
    assert found.sd == pytest.approx(SD, rel=0.05)
    assert f"drifting by {found.drift:.2g}" in found.source


def test_correlation_and_drift_together():
    walk = np.cumsum(white(3), axis=0) / np.sqrt(FRAMES)
    found = refined(simulated() + SD * (correlated(0.5) + 4.0 * walk))
    assert lag_one(found) == pytest.approx(0.5, abs=0.12)
    assert found.drift == pytest.approx(4.0, rel=0.15)
    assert found.sd == pytest.approx(SD, rel=0.08)


@pytest.mark.parametrize("beside, most", [(0.0, 0.1), (0.02, 0.25)])
@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_channels_of_uneven_noise(beside, most, rho):
    true = SD * np.exp(0.6 * np.random.default_rng(4).normal(size=len(CHANNELS)))
    found = refined(simulated() + true * correlated(rho) + beside * misfit())
    off = np.log(found.sd / true)
    assert np.sqrt(np.mean(off**2)) < most
    assert abs(off.mean()) < 0.05
    assert lag_one(found) == pytest.approx(rho, abs=0.05)
    assert "uneven over the channels" in found.source


def test_misfit_is_no_noise_of_its_channels():
    """Without what tied channels share, the noisiest would be those that the touches change."""
    rng = np.random.default_rng(11)
    course = rng.normal(size=(FRAMES, 30)) @ rng.normal(size=(30, EVEN.shape[1]))
    course *= np.exp(rng.normal(size=EVEN.shape[1]))
    found = refined(simulated() + SD * correlated(0.6) + 0.5 * SD * course @ EVEN.T)
    assert np.std(np.log(found.sd / SD)) < 0.15
    assert found.sd.mean() == pytest.approx(SD, rel=0.06)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_loud_frames_and_spikes(rho):
    rng = np.random.default_rng(5)
    voltage = simulated() + SD * correlated(rho) + 0.3 * misfit()
    loud, struck = [7, 40, 41], np.zeros(voltage.shape, bool)
    voltage[loud] += SD * np.array([[12.0], [300.0], [50.0]]) * rng.normal(size=(3, len(CHANNELS)))
    struck[rng.choice([n for n in range(FRAMES) if n not in loud], 25), rng.choice(108, 25)] = True
    voltage += np.where(struck, rng.choice([-1.0, 1.0], voltage.shape) * 0.1, 0.0)
    found = refined(voltage)
    assert found.loud_frames == (7, 40, 41)
    assert found.rejected_mask[loud].all()
    found.rejected_mask[loud] = False
    assert (found.rejected_mask == struck).all() and found.spike_count == struck.sum()
    assert found.sd == pytest.approx(SD, rel=0.08)
    assert lag_one(found) == pytest.approx(rho, abs=0.02)
    assert f"3 loud frames and {struck.sum()} spikes put aside" in found.source


def test_what_lasts_is_no_spike():
    voltage = simulated() + SD * white()
    voltage[30:34, 17] += 0.1
    assert refined(voltage).spike_count == 0


def test_what_tied_channels_have_with_opposite_signs_is_no_spike():
    voltage = simulated() + SD * white()
    voltage[[30, 50]] += 0.1 * ODD[:, 8]
    assert refined(voltage).spike_count == 0
    voltage[30, np.argmax(ODD[:, 8])] += 0.1
    assert refined(voltage).spike_count == 1


def test_too_many_spikes_are_none():
    voltage = simulated() + SD * white()
    struck = np.random.default_rng(6).random(voltage.shape) < 0.08
    assert refined(voltage + 0.1 * struck).spike_count == 0


def test_where_reciprocity_ties_nothing():
    one = ONE_OF_EACH
    rho = refine_noise(
        recording((simulated() + SD * correlated(0.8))[:, one], CHANNELS[one]),
        noise(0.5 * SD, CHANNELS[one]),
        simulated()[:, one],
    )
    assert lag_one(rho) == pytest.approx(0.8, abs=0.04)
    assert rho.sd == pytest.approx(SD, rel=0.1)
    voltage = (simulated() + SD * white())[:, one]
    voltage[33, 5] += 0.1
    voltage[50] *= 1.0 + 0.5 * white(7, len(one))[0]
    found = refine_noise(
        recording(voltage, CHANNELS[one]), noise(channels=CHANNELS[one]), simulated()[:, one]
    )
    assert found.loud_frames == (50,) and found.spike_count == 1 and found.rejected_mask[33, 5]
    assert found.sd == pytest.approx(SD, rel=0.05)


def test_readings_that_are_lost():
    voltage = simulated() + SD * correlated(0.9)
    voltage[np.random.default_rng(8).random(voltage.shape) < 0.02] = np.nan
    voltage[11], voltage[:, 4] = np.nan, np.nan
    voltage[8:30, 20] = np.nan  # all of a touch
    found = refined(voltage, noise(0.5 * SD))
    assert lag_one(found) == pytest.approx(0.9, abs=0.02)
    assert found.sd == pytest.approx(SD, rel=0.12) and found.rejected_mask is None


def test_frames_that_cannot_be_simulated_tell_nothing():
    shown = simulated()
    shown[20:30] = np.nan
    voltage = simulated() + SD * correlated(0.8)
    voltage[20:30] *= 3.0
    found = refined(voltage, noise(0.5 * SD), shown)
    assert lag_one(found) == pytest.approx(0.8, abs=0.04)
    assert found.sd == pytest.approx(SD, rel=0.1) and found.loud_frames == ()


def test_differences_and_magnitudes():
    rest = SD * white(9)[:1]
    change = simulated() + SD * correlated(0.8) - simulated()[:1] - rest
    found = refined(change, noise(0.5 * SD), simulated() - simulated()[:1], values="difference")
    assert lag_one(found) == pytest.approx(0.8, abs=0.04)
    voltage, shown = np.abs(simulated() + SD * correlated(0.8)), np.abs(simulated())
    found = refine_noise(recording(voltage, voltage="magnitude"), noise(0.5 * SD), shown)
    assert lag_one(found) == pytest.approx(0.8, abs=0.04)


@pytest.mark.parametrize(
    "few",
    [
        lambda values: values[:1],
        lambda values: values[:12],
        lambda values: np.full_like(values, np.nan),
    ],
)
def test_where_too_little_is_left_nothing_changes(few):
    before = noise()
    voltage = few(simulated() + 3.0 * SD * white())
    assert refined(voltage, before, simulated()[: len(voltage)]) is before


def test_a_recording_without_noise_or_touches():
    before = noise()
    assert refined(simulated(), before) is before
    rest = np.repeat(simulated()[:1], FRAMES, axis=0)
    found = refined(rest + SD * correlated(0.8), before, rest)
    assert lag_one(found) == pytest.approx(0.8, abs=0.04)


def test_what_is_known_of_rounding_stays():
    before = replace(noise(0.5 * SD), rounding_sd=1e-4)
    assert refined(simulated() + SD * correlated(0.8), before).rounding_sd == 1e-4


def test_channels_that_say_nothing():
    """One that always reads the same, and two that are copies of one another."""
    voltage = simulated() + SD * correlated(0.8)
    pair = np.flatnonzero(ODD[:, 7])
    voltage[:, pair[1]] = -np.prod(np.sign(ODD[pair, 7])) * voltage[:, pair[0]]
    shown = simulated()
    dead = np.flatnonzero(ODD[:, 9])[0]
    voltage[:, dead] = shown[:, dead] = 0.0
    found = refined(voltage, noise(0.5 * SD), shown)
    assert lag_one(found) == pytest.approx(0.8, abs=0.04)
    assert found.sd.min() > 0.4 * SD
    copies = voltage @ EVEN @ EVEN.T
    before = noise()
    assert refined(copies, before, shown @ EVEN @ EVEN.T) is before
