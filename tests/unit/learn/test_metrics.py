import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import mean_absolute_error, r2_score, root_mean_squared_error

from eitskin.learn import metrics
from synthetic_touches import touches


@given(st.integers(0, 10_000), st.integers(3, 50))
def test_metrics_equal_scikit_learns(seed, n):
    truth, predicted = np.random.default_rng(seed).normal(size=(2, n))
    assert metrics.r2(truth, predicted) == pytest.approx(r2_score(truth, predicted))
    assert metrics.mae(truth, predicted) == pytest.approx(mean_absolute_error(truth, predicted))
    assert metrics.rmse(truth, predicted) == pytest.approx(
        root_mean_squared_error(truth, predicted)
    )


def test_r2_of_a_constant_truth_is_unknown():
    assert np.isnan(metrics.r2(np.ones(5), np.arange(5.0)))


def test_interval_is_students():
    # t(0.975, 4) = 2.776445, s = sqrt(2.5)
    low, high = metrics.interval(np.array([1.0, 2, 3, 4, 5]))
    assert (low, high) == pytest.approx(
        (3 - 2.776445 * np.sqrt(2.5 / 5), 3 + 2.776445 * np.sqrt(2.5 / 5))
    )
    assert np.isnan(metrics.interval(np.array([1.0]))).all()


def test_interval_covers_the_mean_as_often_as_it_says():
    draws = np.random.default_rng(1).normal(7, 2, (4000, 3))
    hits = [low <= 7 <= high for low, high in map(metrics.interval, draws)]
    assert np.mean(hits) == pytest.approx(0.95, abs=0.012)


HEADER = {"model": "mlp", "trained_samples": 128, "budget": {"epochs": 40}}


def predictions(data, errors):
    """Test predictions by one seed for each error, wrong by it in every target."""
    tables = []
    for seed, error in enumerate(errors):
        table = data.table[["sample", "x_mm", "y_mm", "force_N"]] + [0, error, error, error]
        tables.append(table.assign(seed=seed))
    return pd.concat(tables)


def test_evaluate_averages_over_seeds():
    data, errors = touches(200, seed=1), [0.1, 0.3, 0.2, 0.15, 0.25]
    rows = metrics.evaluate(predictions(data, errors), data, "place", "small", HEADER)
    assert list(rows.columns) == list(metrics.COLUMNS) and len(rows) == 9
    force = rows[(rows["target"] == "F") & (rows["metric"] == "mae")].iloc[0]
    assert force["mean"] == pytest.approx(0.2) and force["each"] == "0.1;0.3;0.2;0.15;0.25"
    assert (force["low"], force["high"]) == pytest.approx(metrics.interval(np.array(errors)))
    assert force["ensemble"] == pytest.approx(0.2)
    assert (force["unit"], force["seeds"], force["split"]) == ("N", 5, "place")
    assert (force["configuration"], force["recording"]) == ("waves", "simulated")
    assert set(rows["unit"][rows["metric"] == "r2"]) == {"1"}
    assert (force["trained_samples"], force["epochs"], force["tested_samples"]) == (128, 40, 200)


def test_a_recording_stands_by_its_name():
    data = touches(200, seed=1)
    data.metadata |= {"configuration": "", "name": "bench-top", "origin": "a citation"}
    rows = metrics.evaluate(predictions(data, [0.1]), data, "random", "small", HEADER)
    assert set(rows["recording"]) == {"bench-top"} and set(rows["configuration"]) == {""}
    assert rows["low"].isna().all() and rows["high"].isna().all()


def test_prediction_is_matched_by_sample_not_by_row():
    data = touches(200, seed=1)
    shuffled = predictions(data, [0.0]).sample(frac=0.5, random_state=1)
    rows = metrics.evaluate(shuffled, data, "random", "small", HEADER)
    np.testing.assert_allclose(rows["mean"][rows["metric"] == "mae"], 0, atol=1e-12)


def test_errors_of_seeds_that_cancel_are_none_of_the_ensemble():
    data = touches(200, seed=1)
    rows = metrics.evaluate(predictions(data, [0.1, -0.1]), data, "place", "small", HEADER)
    errors = rows[rows["metric"] == "mae"]
    assert errors["mean"].to_numpy() == pytest.approx(0.1)
    assert errors["ensemble"].to_numpy() == pytest.approx(0.0, abs=1e-12)


def test_fewer_than_five_seeds_have_no_interval():
    four = metrics.summary(np.array([0.1, 0.3, 0.2, 0.2]), "mae")
    assert np.isnan([four["low"], four["high"]]).all() and four["each"] == "0.1;0.3;0.2;0.2"


@given(st.lists(st.floats(0, 1), min_size=5, max_size=9), st.sampled_from([*metrics.METRICS]))
def test_an_interval_holds_nothing_that_cannot_be(values, metric):
    if metric == "r2":
        values = [1.0 - 10.0 * value for value in values]
    statistics = metrics.summary(np.array(values), metric)
    assert (
        statistics["low"] <= statistics["mean"] + 1e-9
        and statistics["mean"] <= statistics["high"] + 1e-9
    )
    assert statistics["high"] <= 1.0 if metric == "r2" else statistics["low"] >= 0.0
