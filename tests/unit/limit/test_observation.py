"""The likelihood against differences, dense algebra and the simulator itself."""

from dataclasses import replace

import numpy as np
import pytest

from authors_strengths import EFFECTS, FORCES
from eitskin.errors import InputError
from eitskin.limit.observation import Covariance, Experiment, Sample
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.sets import (
    SkinStage,
    continuous_samples,
    write_dataset,
    write_skin_stage,
    write_stage,
)
from eitskin.simulate.stages import Stage

SKIN = {
    "radius_mm": 80.0,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": [45.0 * k for k in range(8)],
    "electrode_width_mm": 0.0,
    "contact_impedivity_ohm_m2": 0.0,
    "current_A": 1e-3,
    "contrast_per_N": 0.9,
}
CHANNELS = channel_table(8)
EXPERIMENT = Experiment(
    Skin.from_metadata(SKIN), CHANNELS, "train", EFFECTS, 0.01, 1, 72.0, 16.0, FORCES, 10.0
)


@pytest.fixture(scope="module")
def model():
    return EXPERIMENT.prior_session()


def drawn(model, seed):
    """A sample and the unknowns it was drawn from, by the generative model itself."""
    rng = np.random.default_rng(seed)
    sample = Sample(model, np.zeros(len(CHANNELS)))
    z = 0.7 * rng.standard_normal(sample.size)
    e, noise = model.change(sample.state(z), z[3:])
    gain = 1.0 + model.gain_spread @ rng.standard_normal(model.gain_spread.shape[1])
    change = model.mixing @ (e * gain) + noise * rng.standard_normal(len(e))
    return replace(sample, delta_V=change), z


def test_unknowns_are_the_configuration_s(model):
    assert model.skin_spread.shape == (10, 10)
    assert np.array_equal(np.diag(model.skin_spread), [0.03] * 2 + [0.5] * 8)
    tie = model.gain_spread / 0.04
    assert tie.shape == (40, 20)
    assert np.array_equal(tie[::-1], tie) and np.array_equal(tie[:20], np.eye(20))


def test_an_untied_odd_or_partial_gain_spread():
    odd = {"name": "channel-gain", "parameters": {"gain": {"sd": 0.1, "tie": "mirror"}}}
    gains = [{**odd, "channels": [3, 4, 7]}]
    spread = replace(EXPERIMENT, effects=gains).prior_session().gain_spread
    assert spread.shape == (40, 2) and np.flatnonzero(spread.any(axis=1)).tolist() == [3, 4, 7]
    assert np.array_equal(spread[3], spread[7]) and spread[4] @ spread[3] == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_gradient_of_the_likelihood(model, seed):
    sample, z = drawn(model, seed)
    z = z + 0.1
    step = 1e-5 * np.eye(sample.size)
    by = [(sample.log(z + h) - sample.log(z - h)) / 2e-5 for h in step]
    gradient = sample.local(z)[1]
    assert np.allclose(gradient, by, rtol=1e-4, atol=1e-3 * np.abs(by).max())


@pytest.mark.parametrize("seed", range(3))
def test_channels_that_are_read_have_the_density_of_all_with_the_rest_left_out(model, seed):
    read = np.random.default_rng(seed).choice(len(CHANNELS), 21, replace=False)
    whole, z = drawn(model, seed)
    sample = Sample(replace(model, read_channels=read), whole.delta_V[read])

    def density(z):
        e, noise = model.change(whole.state(z), z[3:])
        mixed = model.mixing @ np.diag(e) @ model.gain_spread
        covariance = (mixed @ mixed.T + noise**2 * np.eye(len(e)))[np.ix_(read, read)]
        left = sample.delta_V - (model.mixing @ e)[read]
        return -0.5 * (left @ np.linalg.solve(covariance, left) + np.linalg.slogdet(covariance)[1])

    assert sample.log(z + 0.1) - sample.log(z) == pytest.approx(density(z + 0.1) - density(z))
    step = 1e-5 * np.eye(sample.size)
    by = [(density(z + h) - density(z - h)) / 2e-5 for h in step]
    assert np.allclose(sample.local(z)[1], by, rtol=1e-4, atol=1e-3 * np.abs(by).max())


def test_differences_agree_with_exact_slopes(model):
    state, unknown = np.array([31.0, -22.0, 6.0]), np.full(10, 0.3)
    exact, differences = model.slopes(state, unknown)[0], model._differences(state, unknown)[0]
    apart = np.abs(exact - differences).max(axis=1)
    assert (apart <= 2e-3 * np.abs(exact).max(axis=1)).all()


def test_a_touch_that_the_rim_clips_has_slopes(model):
    squeezed = np.zeros(10)
    squeezed[0] = -2.0
    slopes, noise = model.slopes(np.array([71.0, 3.0, 6.0]), squeezed)
    assert np.isfinite(slopes).all() and np.isfinite(noise).all() and np.abs(slopes[0]).max() > 0


def test_covariance_is_that_of_drawn_gains_and_noise(model):
    state, mean = np.array([40.0, 10.0, 7.0]), np.zeros(10)
    covariance = Covariance(model, *model.change(state, mean))
    mixed = model.mixing @ np.diag(covariance.e) @ model.gain_spread
    dense = mixed @ mixed.T + covariance.noise**2 * np.eye(40)
    assert np.allclose(covariance.inverse @ dense, np.eye(40), atol=1e-8)
    assert covariance.log_determinant == pytest.approx(np.linalg.slogdet(dense)[1])


def test_information_of_a_known_gain_is_least_squares(model):
    known = model.at_mean()
    state, none = np.array([40.0, 10.0, 7.0]), np.zeros(0)
    covariance = Covariance(known, *known.change(state, none))
    slopes = known.slopes(state, none)
    found = covariance.information(*slopes)
    readings = slopes[0] @ known.mixing.T / covariance.noise
    variance = 2.0 * 40 * np.outer(slopes[1], slopes[1]) / covariance.noise**2
    assert np.allclose(found, readings @ readings.T + variance, rtol=1e-8)


@pytest.mark.parametrize("baseline", ["paired", "averaged"])
def test_a_session_known_is_the_simulator(tmp_path, baseline):
    """Noise-free changes and the noise's size, stage by stage as a set is made."""
    table = continuous_samples(12, 4, 1, 72.0, 16.0, FORCES)
    mesh, grid = tmp_path / "mesh.npz", tmp_path / "grid.csv"
    np.savez(mesh, channels=CHANNELS, force_N=np.arange(12.0))
    table.iloc[:1].assign(radius_mm=8.0).to_csv(grid)
    own = {"reach_mm": 72.0, "probe_mm": 16.0, "forces": FORCES}
    stages = [tmp_path / f"{k}.parquet" for k in range(4)]
    skin_stage = SkinStage(1, SKIN, "train", EFFECTS[:2], 4, False, own)
    write_skin_stage(mesh, grid, stages[0], skin_stage)
    for k, effect in enumerate(EFFECTS[2:], start=1):
        write_stage(stages[k - 1], stages[k], 1, effect, k)
    made, untouched, touched = Stage(stages[-1]).joined()
    assert np.array_equal(made[["x_mm", "force_N"]], table[["x_mm", "force_N"]])
    write_dataset(stages[-1], tmp_path / "set.parquet", "own-continuous", 1, 0.01, baseline)
    frames = 1 if baseline == "paired" else 4
    experiment = replace(EXPERIMENT, averaged=frames)
    for row in (0, 5, 11):
        known = experiment.drawn_session(1, int(table["session"][row]))
        state = table.loc[row, ["x_mm", "y_mm", "force_N"]].to_numpy(float)
        e, noise = known.change(state, np.zeros(0))
        change = touched[row].astype(float) - untouched[row]
        assert np.allclose(known.mixing @ e, change, atol=1e-6 * np.abs(touched[row]).max())
        still, full = (np.median(np.abs(v[row])) for v in (untouched, touched))
        assert noise == pytest.approx(0.01 * np.sqrt(still**2 / frames + full**2), rel=1e-5)


@pytest.mark.parametrize(
    ("effects", "found"),
    [
        ([{"name": "offset", "parameters": {"volt": 1e-3}}], r"effects\[0\]\.name: found 'offset'"),
        ([EFFECTS[0], EFFECTS[0]], r"effects\[1\]\.name: found 'ellipse'"),
        (
            [{"name": "crosstalk", "parameters": {"epsilon": {"sd": 0.01}}}],
            r"effects\[0\]\.epsilon: found \{'sd': 0.01\}",
        ),
    ],
)
def test_effects_without_a_likelihood_are_refused(effects, found):
    with pytest.raises(InputError, match=found):
        replace(EXPERIMENT, effects=effects)
