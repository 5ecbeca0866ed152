"""Squared errors that differ, by units that err together."""

import math

import numpy as np
import pytest
from scipy.stats import norm, t

from eitskin.diagnose.fitting.harm import harm

UNIT = np.repeat(np.arange(4), 3)[:, None] * np.ones((1, 2), int)


def test_by_hand():
    there = np.zeros((3, 1))
    after, before = np.array([[1.0], [2.0], [3.0]]), np.ones((3, 1))
    said = harm(after, before, there, np.arange(3)[:, None])
    assert said["rmse_V"] == pytest.approx(math.sqrt(14 / 3)) and said["rmse_before_V"] == 1.0
    differences = np.array([0.0, 3.0, 8.0])
    error = differences.std(ddof=1) / math.sqrt(3)
    rare = t.sf(differences.mean() / error, 2)
    assert said["standard_errors"] == pytest.approx(norm.isf(rare))
    assert said["units"] == 3
    back = harm(before, after, there, np.arange(3)[:, None])
    assert back["standard_errors"] == -said["standard_errors"]


def test_readings_of_one_unit_are_one():
    rng = np.random.default_rng(1)
    there = np.zeros((12, 2))
    of_unit = rng.standard_normal(4)[UNIT]
    single = harm(of_unit[::3, :1], there[::3, :1], there[::3, :1], np.arange(4)[:, None])
    said = harm(of_unit, there, there, UNIT)
    assert said["standard_errors"] == pytest.approx(single["standard_errors"])
    assert said["units"] == 4


@pytest.mark.parametrize("units", [3, 4, 40])
def test_standard_errors_are_normal_where_neither_is_better(units):
    rng = np.random.default_rng(2)
    unit = np.arange(units)[:, None] * np.ones((1, 5), int)
    there = np.zeros(unit.shape)
    apart = []
    for _ in range(1000):
        after, before = (
            rng.standard_normal((units, 1)) + rng.standard_normal(unit.shape) for _ in range(2)
        )
        apart.append(harm(after, before, there, unit)["standard_errors"])
    assert 0.8 < np.std(apart) < 1.1
    assert np.mean(np.abs(apart) > 2.0) < 0.065


@pytest.mark.parametrize(("units", "scale"), [(4, 1e-9), (400, 1e-3)])
def test_what_is_far_off_is_large_and_of_the_right_sign(units, scale):
    unit, there = np.arange(units)[:, None], np.zeros((units, 1))
    large = 2.0 + scale * np.random.default_rng(3).standard_normal((units, 1))
    worse, better = (
        harm(*pair, there, unit)["standard_errors"]
        for pair in ((large, there + 1.0), (there + 1.0, large))
    )
    assert worse == -better > 5.0
    alike = harm(there + 2.0, there + 1.0, there, unit)
    assert alike["standard_errors"] == math.inf


def test_equal_predictions_are_none_worse():
    there = np.arange(24.0).reshape(12, 2)
    assert harm(there + 1.0, there + 1.0, there, UNIT)["standard_errors"] == 0.0


def test_what_is_not_there_is_not_compared():
    there = np.zeros((12, 2))
    there[:, 1] = np.nan
    after = np.column_stack([np.ones(12), np.full(12, 99.0)])
    assert harm(after, 2.0 * after, there, UNIT)["rmse_V"] == 1.0


@pytest.mark.parametrize("after", [2.0, 1.0, 0.5])
def test_of_one_unit_there_is_no_verdict(after):
    there, one = np.zeros((3, 1)), np.zeros((3, 1), int)
    said = harm(np.full((3, 1), after), np.ones((3, 1)), there, one)
    assert math.isnan(said["standard_errors"]) and said["rmse_V"] == after


@pytest.mark.parametrize("after", [np.nan, np.inf])
def test_a_prediction_has_to_be_finite(after):
    with pytest.raises(ValueError, match="not finite"):
        harm(np.full((12, 2), after), np.ones((12, 2)), np.zeros((12, 2)), UNIT)
