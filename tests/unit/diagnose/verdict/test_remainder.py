"""What is left that no name accounts for: how probable it is that there is something."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.diagnose.verdict.atlas import COLUMNS
from eitskin.diagnose.verdict.remainder import (
    LARGEST_LOG_FACTOR,
    PRIOR,
    WEIGHT,
    changes,
    log_bayes_factor,
    probability,
    remainder,
    unlike_remainder,
)


@pytest.mark.parametrize("p", [0.3, 1e-2, 1e-6])
def test_the_bayes_factor_is_sellkes(p):
    assert np.exp(log_bayes_factor(p)) == pytest.approx(-1.0 / (np.e * p * np.log(p)))


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_smaller_p_value_makes_something_no_less_probable(a, b):
    assert probability(min(a, b)) >= probability(max(a, b)) >= PRIOR * (1.0 - 1e-12)


def test_no_p_value_makes_it_certain():
    most = PRIOR / (1.0 - PRIOR) * np.exp(WEIGHT * LARGEST_LOG_FACTOR)
    assert probability(0.0) == pytest.approx(most / (1.0 + most))
    assert probability(1.0) == pytest.approx(PRIOR)


def test_what_is_left_is_as_long_as_the_row_that_has_most():
    """Of which its own directions' share of chance, a unit each, is none; whatever its p."""
    rows = [("constant: electrode", "3", 10.0, 1), ("touch signal: any channel", "all", 61.0, 36)]
    told = pd.DataFrame(
        [(*row, 1.0, 1.0, 1.0, "A.") for row in [*rows, ("everything", "all", 900.0, 500)]],
        columns=COLUMNS,
    )
    assert remainder(told).snr == 5.0
    assert remainder(told[told["statistic"] == "constant: electrode"]).snr == 3.0
    assert remainder(told[told["statistic"] == "everything"]).snr == 0.0
    quiet = told.assign(value=told["dof"] / 2.0)
    assert remainder(quiet).snr == 0.0


def test_of_a_table_without_a_discovery_nothing_passes():
    rows = [("press: any channel", "3", 10.0, 1, 0.5, 1.0, 0.5, "A.")]
    for told in (pd.DataFrame(rows, columns=COLUMNS), pd.DataFrame([], columns=COLUMNS)):
        assert changes(told) == [] and remainder(told).probability < 0.5


def test_readings_of_no_such_skin_are_said_to_be_none():
    found = unlike_remainder(0.22)
    assert (
        found.probability == probability(0.0)
        and found.snr == np.inf
        and "correlation with the simulation is 0.22" in found.sentence
    )
