"""Errors of models over those of the posterior mean, on the same test samples."""

import numpy as np
import pandas as pd

from eitskin.errors import InputError
from eitskin.learn import metrics
from eitskin.limit.score import ESTIMATES, TARGETS, resampled_sessions

COLUMNS = (
    *("configuration", "split", "model", "target", "metric", "value", "limit"),
    *("ratio", "low", "high", "unit", "samples", "sessions", "seeds"),
)
ERRORS = ("mae", "rmse")


def ratios(
    predictions: dict[str, pd.DataFrame], samples: pd.DataFrame, configuration: str, seed: int
) -> pd.DataFrame:
    """Rows (COLUMNS) of each model, target and error.

    predictions: by model, as from `predict.predict_part`; samples: rows of
    `posterior_mean.estimates`, of which those of the estimate "limit" are used. `value` is the mean
    over a model's seeds; the mean of several seeds has rows of its own, as "-ensemble". `ratio` is
    value / limit, `low` and `high` its 95 % bootstrap interval over sessions, resampled together
    for model and limit. Raises InputError without a model, and for a model that lacks a sample.
    """
    if not predictions:
        raise InputError(configuration, "models", "none", "at least one in `table_1`")
    limit = samples[samples["estimate"] == ESTIMATES[0]].reset_index(drop=True)
    resamples = resampled_sessions(limit, seed)
    rows = []
    for model, states in _by_model(predictions, limit["sample"]).items():
        for target, column in TARGETS.items():
            truth, posterior_mean = limit[column].to_numpy(), limit[f"{column}_mean"].to_numpy()
            for name in ERRORS:
                errors = [
                    _errors(name, truth[k], states[column][:, k], posterior_mean[k])
                    for k in resamples
                ]
                value, limit_error = _errors(name, truth, states[column], posterior_mean)
                low, high = np.quantile(
                    [model_error / limit_value for model_error, limit_value in errors],
                    [0.025, 0.975],
                )
                rows.append(
                    {
                        "configuration": configuration,
                        "split": "continuous",
                        "model": model,
                        "target": target,
                        "metric": name,
                        "value": value,
                        "limit": limit_error,
                        "ratio": value / limit_error,
                        "low": float(low),
                        "high": float(high),
                        "unit": metrics.unit(name, target),
                        "samples": len(limit),
                        "sessions": limit["session"].nunique(),
                        "seeds": len(states[column]),
                    }
                )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _errors(
    name: str, truth: np.ndarray, states: np.ndarray, posterior_mean: np.ndarray
) -> tuple[float, float]:
    """The error of a model, mean over its seeds' states (S, n), and that of the limit."""
    error = metrics.METRICS[name]
    return float(np.mean([error(truth, state) for state in states])), error(truth, posterior_mean)


def _by_model(
    predictions: dict[str, pd.DataFrame], samples: pd.Series
) -> dict[str, dict[str, np.ndarray]]:
    """Predictions (S, n) of every seed, by model or ensemble and column of a target."""
    predicted = {}
    for model, table in predictions.items():
        by_column = {}
        for column in TARGETS.values():
            wide = table.pivot(index="seed", columns="sample", values=column)
            wide = wide.reindex(columns=samples)
            missing = wide.columns[wide.isna().any()]
            if len(missing):
                expected = f"the {len(samples)} samples of the limit, of every seed"
                raise InputError(model, "predictions", f"none of sample {missing[0]}", expected)
            by_column[column] = wide.to_numpy()
        predicted[model] = by_column
        if len(by_column[column]) > 1:
            mean = {
                column: states.mean(axis=0, keepdims=True) for column, states in by_column.items()
            }
            predicted[model + metrics.ENSEMBLE] = mean
    return predicted
