"""What a p-value is worth, found from recordings of which it is known."""

import numpy as np
import pytest

from eitskin.diagnose.verdict.remainder import PRIOR
from proof.other_probability import PLAN, fitted


def test_the_weight_of_drawn_odds_is_found():
    rng = np.random.default_rng(1)
    factor = rng.uniform(0.0, 9.0, 40_000)
    odds = np.log(PRIOR / (1.0 - PRIOR)) + 0.8 * np.minimum(factor, 5.0)
    there = rng.uniform(size=len(odds)) < 1.0 / (1.0 + np.exp(-odds))
    found = {
        most: (weight, likelihood)
        for most, weight, likelihood in fitted(factor, there, there.mean())
    }
    assert found[5.0][0] == pytest.approx(0.8, rel=0.03)
    assert max(found, key=lambda most: found[most][1]) == 5.0


def test_none_of_its_recordings_is_reported():
    assert all(seed < 200_000 for _, seed in PLAN) and len(set(PLAN)) == len(PLAN)
