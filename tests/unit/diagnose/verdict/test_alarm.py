"""How much it takes for an alarm of something without a name."""

import numpy as np
import pandas as pd
import pytest

from eitskin.diagnose.verdict.atlas import COLUMNS
from eitskin.diagnose.verdict.remainder import probability, remainder


def rows_of(p_values):
    """An atlas of as many rows, the value of each by its p-value."""
    rows = [
        ("constant: electrode", str(k), 1.0, 1, p, p, p, "A sentence.")
        for k, p in enumerate(sorted(p_values))
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


@pytest.mark.parametrize(("smallest", "count"), [(1e-2, 40), (1e-4, 200)])
def test_one_small_p_value_among_many_rows_is_no_alarm(smallest, count):
    """The same is, by itself, where it is small enough."""
    nulls = np.linspace(0.02, 1.0, count - 1)
    among_many = remainder(rows_of([smallest, *nulls]))
    assert among_many.probability < 0.5 and among_many.sentence is None
    alone = remainder(rows_of([smallest]))
    assert alone.p_value < among_many.p_value
    assert (alone.probability > 0.5) == (smallest < 1e-3)


def test_no_p_value_says_more_than_development_recordings_bear_out():
    assert probability(0.0) == pytest.approx(0.76, abs=0.01)
