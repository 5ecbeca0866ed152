"""The black boxes learn what can be learned, so that beating them means something."""

import numpy as np
import pandas as pd
import pytest

from proof.black_box import features, predictions


@pytest.fixture(scope="module")
def learned():
    rng = np.random.default_rng(1)
    known, asked = rng.uniform(-1, 1, (120, 3)), rng.uniform(-0.9, 0.9, (40, 3))
    pattern = rng.standard_normal((2, 60))

    def misfit(at):
        return 3.0 + 10 * np.sin(2 * at[:, :1]) * pattern[0] + 5 * at[:, 1:2] ** 2 * pattern[1]

    noisy = misfit(known) + rng.standard_normal((120, 60))
    return misfit(asked), predictions(known, noisy, asked, 1), (known, noisy, asked)


@pytest.mark.parametrize("name", ["gp", "mlp"])
def test_a_smooth_misfit_is_learned_to_below_the_noise(learned, name):
    truth, told, _ = learned
    assert np.sqrt(((told[name] - truth) ** 2).mean()) < 0.7
    assert truth.std() > 5


def test_equal_seeds_give_equal_predictions(learned):
    _, told, (known, noisy, asked) = learned
    again = predictions(known, noisy, asked, 1)
    assert all(np.array_equal(told[name], again[name]) for name in told)


def test_a_constant_misfit_is_its_mean():
    known, asked = np.random.default_rng(2).uniform(size=(2, 50, 4))
    for values in predictions(known, np.full((50, 20), 2.5), asked, 1).values():
        assert values == pytest.approx(np.full((50, 20), 2.5), abs=1e-3)


def test_features_tell_loading_from_unloading():
    states = pd.DataFrame(
        {
            "x_mm": [np.nan, 1.0, 1.0, 1.0],
            "y_mm": [np.nan, 2.0, 2.0, 2.0],
            "force_N": [0.0, 3.0, 5.0, 4.0],
            "probe_mm": [np.nan, 10.0, 10.0, 10.0],
            "time_s": [0.0, 1.0, 2.0, 3.0],
            "contact": pd.array([None, 0, 0, 0], dtype="Int64"),
        }
    )
    made = features(states)
    assert made[0].tolist() == [0, 0, 0, 0, 0, 0]
    assert made[:, 5].tolist() == [0, 0, 0, 1]
    assert made[3, :4].tolist() == [1, 2, 4, 10]
