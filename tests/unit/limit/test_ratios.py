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
    limit_rows = pd.DataFrame({"sample": np.arange(N) * 3, "session": np.arange(N) % SESSIONS})
    for column in TARGETS.values():
        limit_rows[column] = rng.normal(size=N)
        limit_rows[f"{column}_mean"] = limit_rows[column] + rng.choice([-1.0, 1.0], N)
    known_rows = limit_rows.assign(
        **{f"{column}_mean": limit_rows[column] for column in TARGETS.values()}
    )
    tables = [limit_rows.assign(estimate="limit"), known_rows.assign(estimate="limit_known")]
    return pd.concat(tables, ignore_index=True)


def predictions(samples, *errors):
    """One seed an error; in any order, among samples that the limit was not asked for."""
    limit = samples[samples["estimate"] == "limit"]
    tables = []
    for seed, error in enumerate(errors):
        columns = {column: limit[column] + error for column in TARGETS.values()}
        seed_rows = pd.DataFrame({"sample": limit["sample"], "seed": seed, **columns})
        untested_rows = seed_rows.assign(sample=seed_rows["sample"] + 1) * [1, 1, 9, 9, 9]
        tables.append(pd.concat([seed_rows, untested_rows]).sample(frac=1.0, random_state=seed))
    return pd.concat(tables)


def test_a_ratio_is_of_the_limits_samples_alone(samples):
    table = ratios.ratios({"mlp": predictions(samples, 1.5, -1.5)}, samples, "a-continuous", 1)
    model_rows = table[table["model"] == "mlp"]
    assert len(model_rows) == 6 and (
        model_rows[["samples", "sessions", "seeds"]] == [N, SESSIONS, 2]
    ).all(axis=None)
    np.testing.assert_allclose(
        model_rows[["value", "limit", "ratio", "low"]], [[1.5, 1.0, 1.5, 1.5]] * 6
    )


def test_an_ensemble_has_rows_of_its_own_and_one_seed_none(samples):
    models = {"mlp": predictions(samples, 1.5, -1.0), "svr": predictions(samples, 1.2)}
    table = ratios.ratios(models, samples, "a-continuous", 1).set_index("model")
    assert set(table.index) == {"mlp", "mlp-ensemble", "svr"}
    np.testing.assert_allclose(table.loc["mlp", "ratio"], 1.25)
    np.testing.assert_allclose(table.loc["mlp-ensemble", "ratio"], 0.25)


def test_intervals_are_paired_and_repeatable(samples):
    """A model as bad as the limit wherever that is bad has no spread; another has."""
    limit = samples[samples["estimate"] == "limit"].set_index("sample")
    worst = limit.index[np.arange(N) % SESSIONS == 0]
    for column in TARGETS.values():
        limit.loc[worst, f"{column}_mean"] += 5.0
    limit_rows = limit.reset_index()
    columns = {column: limit_rows[f"{column}_mean"] for column in TARGETS.values()}
    equal_model = pd.DataFrame({"sample": limit_rows["sample"], "seed": 1, **columns})
    models = {"alike": equal_model, "constant": predictions(samples, 1.0)}
    table = ratios.ratios(models, limit_rows, "a-continuous", 1).set_index("model")
    np.testing.assert_allclose(table.loc["alike", ["low", "ratio", "high"]], 1.0)
    constant = table.loc["constant"]
    assert (constant["low"] < constant["ratio"]).all() and (
        constant["high"] > constant["low"]
    ).all()
    assert ratios.ratios(models, limit_rows, "a-continuous", 1).set_index("model").equals(table)


@pytest.mark.parametrize("without", ["sample != 9", "sample != 9 or seed != 1"])
def test_a_sample_that_a_model_lacks_is_named(samples, without):
    lacking = predictions(samples, 1.0, 2.0).query(without)
    with pytest.raises(InputError, match="mlp: predictions: found none of sample 9"):
        ratios.ratios({"mlp": lacking}, samples, "a-continuous", 1)


def test_nothing_to_hold_against_the_limit_is_refused(samples):
    with pytest.raises(InputError, match="a-continuous: models: found none"):
        ratios.ratios({}, samples, "a-continuous", 1)
