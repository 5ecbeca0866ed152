"""Squared errors that differ, by units that err together."""

import math

import numpy as np
import pytest

from eitskin.diagnose.harm import harm

UNIT = np.repeat(np.arange(4), 3)[:, None] * np.ones((1, 2), int)


def test_by_hand():
    there = np.zeros((3, 1))
    after, before = np.array([[1.0], [2.0], [3.0]]), np.ones((3, 1))
    said = harm(after, before, there, np.arange(3)[:, None])
    assert said["rmse_V"] == pytest.approx(math.sqrt(14 / 3)) and said["rmse_before_V"] == 1.0
    differences = np.array([0.0, 3.0, 8.0])
    error = differences.std(ddof=1) / math.sqrt(3)
    assert said["standard_errors"] == pytest.approx(differences.mean() / error)
    assert said["units"] == 3


def test_readings_of_one_unit_are_one():
    rng = np.random.default_rng(1)
    there = np.zeros((12, 2))
    of_unit = rng.standard_normal(4)[UNIT]
    single = harm(of_unit[::3, :1], there[::3, :1], there[::3, :1], np.arange(4)[:, None])
    said = harm(of_unit, there, there, UNIT)
    assert said["standard_errors"] == pytest.approx(single["standard_errors"])
    assert said["units"] == 4


def test_two_standard_errors_are_rare_where_neither_is_better():
    rng = np.random.default_rng(2)
    unit = np.arange(40)[:, None] * np.ones((1, 5), int)
    there = np.zeros(unit.shape)
    apart = []
    for _ in range(400):
        after, before = (
            rng.standard_normal((40, 1)) + rng.standard_normal(unit.shape) for _ in range(2)
        )
        apart.append(harm(after, before, there, unit)["standard_errors"])
    assert 0.9 < np.std(apart) < 1.1


def test_equal_predictions_are_none_worse():
    there = np.arange(24.0).reshape(12, 2)
    assert harm(there + 1.0, there + 1.0, there, UNIT)["standard_errors"] == 0.0


def test_what_is_not_there_is_not_compared():
    there = np.zeros((12, 2))
    there[:, 1] = np.nan
    after = np.column_stack([np.ones(12), np.full(12, 99.0)])
    assert harm(after, 2.0 * after, there, UNIT)["rmse_V"] == 1.0


@pytest.mark.parametrize(("after", "sign"), [(2.0, 1.0), (0.5, -1.0)])
def test_one_unit_has_no_standard_error(after, sign):
    there, one = np.zeros((3, 1)), np.zeros((3, 1), int)
    said = harm(np.full((3, 1), after), np.ones((3, 1)), there, one)
    assert said["standard_errors"] == sign * math.inf


@pytest.mark.parametrize("after", [np.nan, np.inf])
def test_a_prediction_has_to_be_finite(after):
    with pytest.raises(ValueError, match="not finite"):
        harm(np.full((12, 2), after), np.ones((12, 2)), np.zeros((12, 2)), UNIT)
