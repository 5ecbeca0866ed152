"""The limit: what it says of itself, and how it is scored."""

import numpy as np
import pandas as pd
import pytest

from authors_strengths import EFFECTS, FORCES
from eitskin.data.dataset import Dataset
from eitskin.learn import metrics
from eitskin.limit import cramer_rao, posterior_mean, score
from eitskin.limit.observation import Experiment, Sample
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.layout import polar_grid

SKIN = Skin(80.0, 3.0, 0.5, tuple(22.5 * np.arange(16)), 0.0, 0.0, 1e-3, 0.9)


def experiment(effects=EFFECTS, noise=0.01, averaged=1):
    channels = channel_table(16)
    return Experiment(SKIN, channels, "train", effects, noise, averaged, 72.0, 16.0, FORCES, 10.0)


def sampled(model, rng):
    """A change, the state behind it and the unknowns, drawn from the model itself."""
    sample = Sample(model, np.zeros(208))
    z = rng.standard_normal(sample.size)
    e, noise = model.change(sample.state(z), z[3:])
    gain = 1.0 + model.gain_spread @ rng.standard_normal(model.gain_spread.shape[1])
    return model.mixing @ (e * gain) + noise * rng.standard_normal(208), sample.state(z), z


@pytest.mark.long
def test_errors_are_as_large_as_the_posterior_says_with_the_skin_known():
    model = experiment().drawn_session(1, 3)
    starts, rng = posterior_mean.Starts(model), np.random.default_rng(2)
    pulls, effective = [], []
    for _ in range(60):
        change, state, _ = sampled(model, rng)
        estimate = posterior_mean.estimate(model, change, starts.nearest(change), 32, rng)
        pulls.append((estimate["mean"] - state) / estimate["sd"])
        effective.append(estimate["effective"])
    # mean square of 180 pulls: 1 ± 0.105
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=0.35)
    assert np.median(effective) > 0.5


@pytest.mark.long
def test_scores_at_the_truth_are_as_large_as_the_information_says():
    """The posterior's gradient at what was drawn has the precision as its covariance."""
    model, rng = experiment().prior_session(), np.random.default_rng(3)
    sizes = []
    for _ in range(40):
        change, _, z = sampled(model, rng)
        _, gradient, information = Sample(model, change).local(z)
        score = gradient - z
        sizes.append(score @ np.linalg.solve(information + np.eye(21), score))
    # mean of 40 of chi-squared with 21 degrees of freedom: 21 ± 1.0
    assert np.mean(sizes) == pytest.approx(21.0, abs=3.5)


def test_an_unknown_skin_s_touch_is_found():
    model, rng = experiment().prior_session(), np.random.default_rng(4)
    change, state, _ = sampled(model, rng)
    estimate = posterior_mean.estimate(
        model, change, posterior_mean.Starts(model).nearest(change), 16, rng
    )
    assert (np.abs(estimate["mean"] - state) < 4.0 * estimate["sd"]).all()
    assert estimate["sd"][:2].max() < 3.0 and estimate["sd"][2] < 2.0


def test_an_untouched_frame_tells_no_place():
    model = experiment().drawn_session(1, 3)
    rng = np.random.default_rng(4)
    noise = model.change(np.zeros(3), np.zeros(0))[1]
    change = noise * rng.standard_normal(208)
    estimate = posterior_mean.estimate(
        model, change, posterior_mean.Starts(model).nearest(change), 200, rng
    )
    assert estimate["mean"][2] < 0.5
    assert np.hypot(*estimate["mean"][:2]) < 30.0 and estimate["sd"][:2].min() > 15.0


def table(n, rng):
    truth = rng.normal(0.0, 30.0, n)
    rows = {"estimate": "limit", "sample": np.arange(n), "session": np.arange(n) // 10}
    for column in score.TARGETS.values():
        rows |= {column: truth, f"{column}_mean": truth + rng.normal(0, 2.0, n)}
        rows[f"{column}_sd"] = 2.0
    return pd.DataFrame(rows)


def test_scores_are_the_metrics_of_the_models():
    samples = table(200, np.random.default_rng(1))
    tested_set = Dataset(samples, np.zeros((200, 1)), {"configuration": "authors"})
    rows = score.score(samples, tested_set, "continuous", 1)
    assert tuple(rows.columns) == score.COLUMNS and len(rows) == 3 * 4
    value = rows.set_index(["target", "metric"])
    truth, mean = samples["x_mm"].to_numpy(), samples["x_mm_mean"].to_numpy()
    for name, metric in metrics.METRICS.items():
        assert value.loc[("x", name), "value"] == metric(truth, mean)
    assert value.loc[("x", "z2"), "value"] == pytest.approx(1.0, abs=0.3)
    assert (rows["low"] < rows["value"]).all() and (rows["value"] < rows["high"]).all()
    assert set(rows["configuration"]) == {"authors"} and set(rows["samples"]) == {200}
    pd.testing.assert_frame_equal(rows, score.score(samples, tested_set, "continuous", 1))


def test_samples_are_tested_ones_and_the_same_each_time(monkeypatch):
    monkeypatch.setattr(posterior_mean, "PLACES", 40)
    prior, rng = experiment(), np.random.default_rng(6)
    sessions = [prior.drawn_session(1, session) for session in range(3)]
    changes, states, _ = zip(*(sampled(sessions[k // 4], rng) for k in range(12)), strict=True)
    frame = pd.DataFrame(np.array(states), columns=list(score.TARGETS.values()))
    frame.insert(0, "sample", np.arange(12))
    frame.insert(1, "session", np.arange(12) // 4)
    tested_set = Dataset(frame, np.array(changes, dtype=np.float32), {})
    part = np.where(np.arange(12) // 4 == 1, "test", "train")
    estimates, repeated = (
        posterior_mean.estimates(prior, tested_set, part, 1, 2, 4) for _ in range(2)
    )
    pd.testing.assert_frame_equal(estimates, repeated)
    assert list(estimates["estimate"]) == ["limit", "limit_known"] * 2
    assert set(estimates["session"]) == {1} and estimates["sample"].nunique() == 2


def test_bounds_at_the_text_s_noise_are_those_computed_before():
    """0.6 to 0.8 mm and 0.42 N, medians over places; noise on one frame, the skin known."""
    model = experiment(noise=0.02, averaged=10**9).prior_session().at_mean()
    grid, rng = polar_grid(80.0, 8, 24, 0.1, 0.9, 16.0), np.random.default_rng(1)
    places = [place for k, place in enumerate(grid.itertuples()) if k % 5 == 0 and k < 168]
    bounds = [
        cramer_rao.bound(model, np.array([p.x_mm, p.y_mm, rng.uniform(0.5, 10.0)])) for p in places
    ]
    x, y, force = np.median(bounds, axis=0)
    assert 0.5 < x < 0.9 and 0.5 < y < 0.9 and force == pytest.approx(0.42, rel=0.3)


def test_what_is_unknown_widens_the_bound_and_what_is_not_drawn_does_not():
    state = np.array([40.0, 10.0, 6.0])
    known_bound, unknown_bound = (
        cramer_rao.bound(model, state)
        for model in (experiment().prior_session().at_mean(), experiment().prior_session())
    )
    assert (unknown_bound >= known_bound).all() and unknown_bound[0] > 1.5 * known_bound[0]
    sure = [
        {**e, "parameters": {k: _still(v) for k, v in e["parameters"].items()}} for e in EFFECTS
    ]
    assert np.allclose(cramer_rao.bound(experiment(sure).prior_session(), state), known_bound)


def _still(value):
    return {**value, "sd": 0.0} if isinstance(value, dict) else value


def test_the_posterior_is_near_its_bound_where_the_prior_says_little():
    """Away from the rim and at middling force a known skin's posterior sd is about the bound's."""
    model = experiment().drawn_session(1, 3)
    state, rng = np.array([45.0, 20.0, 5.0]), np.random.default_rng(5)
    e, noise = model.change(state, np.zeros(0))
    change = model.mixing @ e + noise * rng.standard_normal(208)
    estimate = posterior_mean.estimate(
        model, change, posterior_mean.Starts(model).nearest(change), 100, rng
    )
    assert estimate["sd"] == pytest.approx(cramer_rao.bound(model, state), rel=0.3)


def test_the_table_of_bounds_leaves_out_the_rim():
    grid = polar_grid(80.0, 2, 3, 0.1, 0.9, 16.0)
    rows = cramer_rao.table(experiment(), grid)
    assert set(rows["place"]) == {0, 1, 2} and len(rows) == 3 * len(cramer_rao.FORCES_N)
    assert np.isfinite(rows.to_numpy()).all()
