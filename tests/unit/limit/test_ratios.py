"""Models held against the limit, sample by sample."""

import numpy as np
import pandas as pd
import pytest

from eitskin.errors import InputError
from eitskin.limit import ratios
from eitskin.limit.score import TARGETS

N, SESSIONS = 60, 6


@pytest.fixture
def samples():
    """Of each session ten samples, the limit's errors ± 1 in every target."""
    rng = np.random.default_rng(1)
    one = pd.DataFrame({"sample": np.arange(N) * 3, "session": np.arange(N) % SESSIONS})
    for column in TARGETS.values():
        one[column] = rng.normal(size=N)
        one[f"{column}_mean"] = one[column] + rng.choice([-1.0, 1.0], N)
    known = one.assign(**{f"{column}_mean": one[column] for column in TARGETS.values()})
    tables = [one.assign(estimate="limit"), known.assign(estimate="limit_known")]
    return pd.concat(tables, ignore_index=True)


def predictions(samples, *errors):
    """One seed an error; in any order, among samples that the limit was not asked for."""
    limit = samples[samples["estimate"] == "limit"]
    tables = []
    for seed, error in enumerate(errors):
        columns = {column: limit[column] + error for column in TARGETS.values()}
        own = pd.DataFrame({"sample": limit["sample"], "seed": seed, **columns})
        other = own.assign(sample=own["sample"] + 1) * [1, 1, 9, 9, 9]
        tables.append(pd.concat([own, other]).sample(frac=1.0, random_state=seed))
    return pd.concat(tables)


def test_a_ratio_is_of_the_limits_samples_alone(samples):
    found = ratios.ratios({"mlp": predictions(samples, 1.5, -1.5)}, samples, "a-continuous", 1)
    own = found[found["model"] == "mlp"]
    assert len(own) == 6 and (own[["samples", "sessions", "seeds"]] == [N, SESSIONS, 2]).all(
        axis=None
    )
    np.testing.assert_allclose(own[["value", "limit", "ratio", "low"]], [[1.5, 1.0, 1.5, 1.5]] * 6)


def test_an_ensemble_has_rows_of_its_own_and_one_seed_none(samples):
    given = {"mlp": predictions(samples, 1.5, -1.0), "svr": predictions(samples, 1.2)}
    found = ratios.ratios(given, samples, "a-continuous", 1).set_index("model")
    assert set(found.index) == {"mlp", "mlp-ensemble", "svr"}
    np.testing.assert_allclose(found.loc["mlp", "ratio"], 1.25)
    np.testing.assert_allclose(found.loc["mlp-ensemble", "ratio"], 0.25)


def test_intervals_are_paired_and_repeatable(samples):
    """A model as bad as the limit wherever that is bad has no spread; another has."""
    limit = samples[samples["estimate"] == "limit"].set_index("sample")
    worst = limit.index[np.arange(N) % SESSIONS == 0]
    for column in TARGETS.values():
        limit.loc[worst, f"{column}_mean"] += 5.0
    told = limit.reset_index()
    columns = {column: told[f"{column}_mean"] for column in TARGETS.values()}
    alike = pd.DataFrame({"sample": told["sample"], "seed": 1, **columns})
    given = {"alike": alike, "constant": predictions(samples, 1.0)}
    found = ratios.ratios(given, told, "a-continuous", 1).set_index("model")
    np.testing.assert_allclose(found.loc["alike", ["low", "ratio", "high"]], 1.0)
    constant = found.loc["constant"]
    assert (constant["low"] < constant["ratio"]).all() and (
        constant["high"] > constant["low"]
    ).all()
    assert ratios.ratios(given, told, "a-continuous", 1).set_index("model").equals(found)


@pytest.mark.parametrize("without", ["sample != 9", "sample != 9 or seed != 1"])
def test_a_sample_that_a_model_lacks_is_named(samples, without):
    lacking = predictions(samples, 1.0, 2.0).query(without)
    with pytest.raises(InputError, match="mlp: predictions: found none of sample 9"):
        ratios.ratios({"mlp": lacking}, samples, "a-continuous", 1)


def test_nothing_to_hold_against_the_limit_is_refused(samples):
    with pytest.raises(InputError, match="a-continuous: models: found none"):
        ratios.ratios({}, samples, "a-continuous", 1)
