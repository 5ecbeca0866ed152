"""Noise from the recording alone: right whatever the instrument does."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kstest

from eitskin.data.recording import Recording
from eitskin.diagnose.noise.converter import converter_step, lasting_rounding_sd
from eitskin.diagnose.noise.estimate import FLOOR, estimate_noise
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate

CHANNELS = channel_table(16)
SKIN = Skin(80.0, 3.0, 0.5, tuple(22.5 * np.arange(16)), 5.0, 2e-3, 1e-3, 0.9)
EFFECTS = {
    "nothing": [],
    "gain": [{"name": "channel-gain", "channels": [20], "parameters": {"gain": 1.05}}],
    "gains": [{"name": "channel-gain", "parameters": {"gain": {"sd": 0.03}}}],
    "offset": [{"name": "offset", "parameters": {"volt": {"sd": 1e-4}}}],
    "crosstalk": [{"name": "crosstalk", "parameters": {"epsilon": 0.02}}],
    "memory": [{"name": "multiplexer-memory", "parameters": {"mu": 0.02}}],
    "skew": [{"name": "frame-skew", "parameters": {"fraction": 0.3}}],
    "mains": [
        {"name": "mains-interference", "parameters": {"frequency_Hz": 50.3, "volt": 1e-4}},
    ],
    "drift": [{"name": "conductivity-drift", "parameters": {"per_minute": 0.003}}],
}


def states(contacts=12):
    """Per contact one untouched frame, five forces up and four down; two untouched at first."""
    rng = np.random.default_rng(0)
    rows, press, time = [(0.0, False, None, None, 0.0), (1.0, False, None, None, 0.0)], [-1, -1], 2
    for k in range(contacts):
        r, angle = 60.0 * np.sqrt(rng.uniform(0, 0.8)), rng.uniform(0, 2 * np.pi)
        rows.append((float(time), False, None, None, 0.0))
        press.append(-1)
        up = np.linspace(1.0, rng.uniform(4.0, 10.0), 5)
        for step, force in enumerate([*up, *up[-2::-1]]):
            place = (r * np.cos(angle), r * np.sin(angle))
            rows.append((time + 3.0 + step, True, *place, force))
            press.append(k)
        time += 13
    table = pd.DataFrame(rows, columns=["time_s", "touch", "x_mm", "y_mm", "force_N"])
    table = table.astype({"x_mm": float, "y_mm": float})
    return table.assign(probe_mm=np.where(table["touch"], 10.0, np.nan)), np.array(press)


STATES, PRESS = states()


@pytest.fixture(scope="module")
def clean():
    def of(items):
        chosen = settings(items, site_counts(CHANNELS), (1, 0))
        return simulate(STATES, PRESS, SKIN, CHANNELS, chosen, "train", frame_s=0.3)

    return {name: of(items) for name, items in EFFECTS.items()}


def recording(readings, channels=CHANNELS, frames=STATES, **metadata):
    given = {"values": "absolute", "voltage": "signed", "channels": channels.tolist()}
    return Recording(frames, readings, None, None, given | metadata)


def noisy(voltage, sd, seed=0):
    return voltage + sd * np.random.default_rng(seed).standard_normal(voltage.shape)


def level_of(clean):
    return np.median(np.abs(clean["nothing"]))


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("share", [3e-4, 2e-2])
def test_an_instrument_s_faults_are_not_noise(clean, name, share):
    sd = share * level_of(clean)
    found = [estimate_noise(recording(noisy(clean[name], sd, seed))) for seed in range(4)]
    ratio = [noise.sd.mean() / sd for noise in found]
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.02)
    assert all(np.ptp(noise.sd) == 0.0 and "alike" in noise.source for noise in found)


@pytest.mark.parametrize("name", ["nothing", "skew", "mains"])
def test_noise_that_grows_with_the_reading(clean, name):
    untouched = np.abs(clean["nothing"][PRESS < 0].mean(axis=0))
    sd = 3e-4 * np.hypot(0.5 * level_of(clean), untouched)
    noise = estimate_noise(recording(noisy(clean[name], sd)))
    assert np.abs(noise.sd / sd - 1.0).max() < 0.06
    assert np.mean(noise.sd / sd) == pytest.approx(1.0, abs=0.02)
    assert "grows" in noise.source


def test_the_degrees_of_freedom_are_the_scatter(clean):
    sd = 1e-3 * level_of(clean)
    found = [estimate_noise(recording(noisy(clean["gains"], sd, seed))) for seed in range(60)]
    z = [(noise.sd[0] ** 2 / sd**2 - 1.0) * np.sqrt(noise.dof / 2.0) for noise in found]
    assert kstest(z, "norm").pvalue > 1e-3


def test_what_only_the_untouched_frames_show_is_no_noise(clean):
    sd = 1e-3 * level_of(clean)
    voltage = noisy(clean["nothing"], sd)
    _, even = parity(CHANNELS)
    wander = noisy(np.zeros_like(voltage), 2.0 * sd, 7) @ even @ even.T
    voltage[PRESS < 0] += wander[PRESS < 0]
    noise = estimate_noise(recording(voltage))
    assert noise.sd.mean() == pytest.approx(sd, rel=0.03)
    assert "more than noise" in noise.source


def test_without_reciprocal_pairs_the_untouched_frames_tell():
    channels = channel_table(16, "adjacent", "opposite")
    v = simulate(STATES, PRESS, SKIN, channels, [], "train")
    sd = 1e-3 * np.median(np.abs(v))
    noise = estimate_noise(recording(noisy(v, sd), channels))
    assert noise.sd.mean() == pytest.approx(sd, rel=0.05)
    assert "14 untouched frames" in noise.source and "reciprocal" not in noise.source


def test_with_one_untouched_frame_and_no_pairs_what_is_incoherent_tells():
    channels = channel_table(16, "adjacent", "opposite")
    v = simulate(STATES, PRESS, SKIN, channels, [], "train")
    keep = np.r_[0, np.flatnonzero(PRESS >= 0)]
    sd = 1e-3 * np.median(np.abs(v))
    frames = STATES.iloc[keep].reset_index(drop=True)
    noise = estimate_noise(recording(noisy(v, sd)[keep], channels, frames))
    assert noise.sd.mean() == pytest.approx(sd, rel=0.05)
    assert "incoherent" in noise.source


def test_lost_readings(clean):
    sd = 1e-3 * level_of(clean)
    voltage = noisy(clean["memory"], sd)
    rng = np.random.default_rng(3)
    voltage[rng.random(voltage.shape) < 0.02] = np.nan
    voltage[:, 17] = np.nan
    voltage[5] = np.nan
    noise = estimate_noise(recording(voltage))
    assert noise.sd.mean() == pytest.approx(sd, rel=0.03)
    assert np.isfinite(noise.sd).all()


def test_magnitudes_and_differences(clean):
    sd = 1e-3 * level_of(clean)
    voltage = noisy(clean["gains"], sd)
    found = estimate_noise(recording(np.abs(voltage), voltage="magnitude"))
    assert found.sd.mean() == pytest.approx(sd, rel=0.02)
    change = (voltage - voltage[PRESS < 0].mean(axis=0))[PRESS >= 0]
    frames = STATES[PRESS >= 0].reset_index(drop=True)
    found = estimate_noise(recording(change, frames=frames, values="difference"))
    assert found.sd.mean() == pytest.approx(sd, rel=0.02)


def test_opposite_drive_ties_channels_by_the_class():
    channels = channel_table(16, "opposite", "opposite")
    odd, even = parity(channels)
    v = simulate(STATES, PRESS, SKIN, channels, [], "train")
    assert np.abs(v @ odd).max() < 1e-8 * np.abs(v).max()
    both = np.column_stack([odd, even])
    assert np.allclose(both.T @ both, np.eye(len(channels)))
    sd = 1e-3 * np.median(np.abs(v))
    assert estimate_noise(recording(noisy(v, sd), channels)).sd.mean() == pytest.approx(
        sd, rel=0.02
    )


def test_no_noise_is_a_floor_that_is_told(clean):
    noise = estimate_noise(recording(clean["nothing"]))
    assert np.allclose(noise.sd, FLOOR * level_of(clean))
    assert "raised" in noise.source


def test_one_frame_gives_a_bound_or_an_assumption(clean):
    sd = 1e-3 * level_of(clean)
    frames = STATES.iloc[:1]
    noise = estimate_noise(recording(noisy(clean["nothing"], sd)[:1], frames=frames))
    assert noise.sd[0] == pytest.approx(sd, rel=0.3)
    assert "upper bound" in noise.source
    channels = channel_table(16, "adjacent", "opposite")
    noise = estimate_noise(recording(np.ones((1, len(channels))), channels, frames))
    assert "assumed" in noise.source and noise.dof == 1.0


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.5, 2.0])
def test_rounding_shows_in_the_noise_whether_frames_repeat_or_not(clean, noise):
    """noise in steps."""
    values = clean["nothing"]
    step = 0.01 * np.median(np.abs(values))
    rng = np.random.default_rng(3)
    rough = values + noise * step * rng.normal(size=values.shape)
    found = estimate_noise(recording(step * np.round(rough / step)))
    assert converter_step(step * np.round(rough / step)) == pytest.approx(step, rel=1e-6)
    expected = step * np.hypot(noise, 12**-0.5)
    assert 0.85 * expected < np.median(found.sd) < 1.35 * expected
    assert ("rounding" in found.source) == (noise < 0.1)


def test_readings_that_do_not_repeat_have_no_step(clean):
    assert converter_step(np.full((3, 4), 0.7)) == 0.0
    repeated = np.tile(clean["nothing"][:3], (30, 1))
    assert converter_step(repeated) == 0.0
    rough = noisy(clean["nothing"], 1e-3 * level_of(clean))
    assert converter_step(rough) == estimate_noise(recording(rough)).rounding_sd == 0.0


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.25, 0.6])
def test_what_rounding_does_alike_against_drawn_readings(noise):
    rng = np.random.default_rng(5)
    at_rest = rng.uniform(size=(400, 1))
    read = np.round(at_rest + noise * rng.normal(size=(400, 4000)))
    drawn = np.std(read.mean(axis=1) - at_rest[:, 0])
    told = lasting_rounding_sd(2.0, 2.0 * np.hypot(noise, 12**-0.5)) / 2.0
    assert told == pytest.approx(drawn, rel=0.08, abs=0.02)


@pytest.mark.parametrize("noise", [0.7, 1.0, 3.0])
def test_rounding_that_is_lost_in_the_noise_does_nothing_alike(noise):
    assert lasting_rounding_sd(2.0, 2.0 * np.hypot(noise, 12**-0.5)) == 0.0
