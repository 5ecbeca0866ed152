"""How far models stay behind what physics allows: their errors over the posterior mean's, on the
very samples that both were tested on."""

import numpy as np
import pandas as pd

from eitskin.errors import InputError
from eitskin.learn import metrics
from eitskin.limit.score import ESTIMATES, TARGETS, sessions_again

COLUMNS = (
    *("configuration", "split", "model", "target", "metric", "value", "limit"),
    *("ratio", "low", "high", "unit", "samples", "sessions", "seeds"),
)
SHOWN = ("mae", "rmse")


def ratios(
    predictions: dict[str, pd.DataFrame], samples: pd.DataFrame, configuration: str, seed: int
) -> pd.DataFrame:
    """Rows (COLUMNS) of each model, target and error.

    predictions: of each model, as `predict.predict_part` gives them; samples: rows of
    `posterior_mean.estimates`, of which the estimate "limit" counts. `value` is the mean over a
    model's seeds, and of several seeds the model's "-ensemble" has rows of its own; `ratio` is
    value / limit, `low` and `high` its 95 % bootstrap interval over whole sessions, in which model
    and limit are resampled alike. Raises InputError without a model, and where one lacks one of the
    samples.
    """
    if not predictions:
        raise InputError(configuration, "models", "none", "at least one in `table_1`")
    limit = samples[samples["estimate"] == ESTIMATES[0]].reset_index(drop=True)
    again = sessions_again(limit, seed)
    rows = []
    for model, states in _of_each(predictions, limit["sample"]).items():
        for target, column in TARGETS.items():
            truth, best = limit[column].to_numpy(), limit[f"{column}_mean"].to_numpy()
            for name in SHOWN:
                errors = [_errors(name, truth[k], states[column][:, k], best[k]) for k in again]
                value, least = _errors(name, truth, states[column], best)
                low, high = np.quantile([own / lowest for own, lowest in errors], [0.025, 0.975])
                rows.append(
                    {
                        "configuration": configuration,
                        "split": "continuous",
                        "model": model,
                        "target": target,
                        "metric": name,
                        "value": value,
                        "limit": least,
                        "ratio": value / least,
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
    name: str, truth: np.ndarray, states: np.ndarray, best: np.ndarray
) -> tuple[float, float]:
    """An error of a model, the mean over its seeds' states (S, n), and the limit's."""
    error = metrics.METRICS[name]
    return float(np.mean([error(truth, one) for one in states])), error(truth, best)


def _of_each(
    predictions: dict[str, pd.DataFrame], samples: pd.Series
) -> dict[str, dict[str, np.ndarray]]:
    """By model, and by ensemble, and column of a target: what its seeds predict (S, n)."""
    found = {}
    for model, table in predictions.items():
        own = {}
        for column in TARGETS.values():
            wide = table.pivot(index="seed", columns="sample", values=column)
            wide = wide.reindex(columns=samples)
            missing = wide.columns[wide.isna().any()]
            if len(missing):
                expected = f"the {len(samples)} samples of the limit, of every seed"
                raise InputError(model, "predictions", f"none of sample {missing[0]}", expected)
            own[column] = wide.to_numpy()
        found[model] = own
        if len(own[column]) > 1:
            mean = {column: states.mean(axis=0, keepdims=True) for column, states in own.items()}
            found[model + metrics.ENSEMBLE] = mean
    return found
