"""Errors of predictions, by target, with intervals over seeds."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from eitskin.atomic import atomic_path
from eitskin.data.dataset import TARGETS, UNITS, Dataset

COLUMNS = (
    "configuration",
    "recording",
    "origin",
    "split",
    "model",
    "target",
    "metric",
    "mean",
    "low",
    "high",
    "each",
    "ensemble",
    "unit",
    "seeds",
    "budget",
    "trained_samples",
    "epochs",
    "tested_samples",
)
ENSEMBLE = "-ensemble"  # after a model's name: the mean of its seeds' estimates, as `predict` gives
MIN_SEEDS = 5  # for an interval over seeds: with fewer, Student's t is too wide to be of use


def r2(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Coefficient of determination, 1 - Σ(s - ŝ)² / Σ(s - mean s)²; NaN for a constant truth."""
    total = ((truth - truth.mean()) ** 2).sum()
    return float(1 - ((truth - predicted) ** 2).sum() / total) if total > 0 else float("nan")


def mae(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Mean absolute error, in the unit of the target."""
    return float(np.abs(truth - predicted).mean())


def rmse(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Root of the mean squared error, in the unit of the target."""
    return float(np.sqrt(((truth - predicted) ** 2).mean()))


METRICS = {"r2": r2, "mae": mae, "rmse": rmse}


def interval(values: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Student's t interval of the mean of `values` (n,); NaN for fewer than two."""
    n = len(values)
    if n < 2:
        return float("nan"), float("nan")
    half = stdtrit(n - 1, 0.5 + level / 2) * np.std(values, ddof=1) / np.sqrt(n)
    return float(np.mean(values) - half), float(np.mean(values) + half)


def interval_of_seeds(values: np.ndarray) -> tuple[float, float]:
    """`interval` of values (n,), one of each seed; NaN for fewer than MIN_SEEDS."""
    return interval(values) if len(values) >= MIN_SEEDS else (float("nan"), float("nan"))


def summary(values: np.ndarray, metric: str) -> dict:
    """Statistics of the seeds' values (n,) of a metric: `mean`, `low` and `high` of
    `interval_of_seeds`, clipped to the metric's range, `each` value, and the number of `seeds`."""
    bounds = (-np.inf, 1.0) if metric == "r2" else (0.0, np.inf)
    low, high = np.clip(interval_of_seeds(values), *bounds).tolist()
    return {
        "mean": float(np.mean(values)),
        "low": low,
        "high": high,
        "each": ";".join(f"{value:.6g}" for value in values),
        "seeds": len(values),
    }


def by_seed(predictions: pd.DataFrame, dataset: Dataset) -> pd.DataFrame:
    """Columns target, metric, seed, value, of predictions with the columns of
    `predict.predict_part`. Frames that are abstained from count as well.
    """
    truth = dataset.table.set_index("sample")
    rows = []
    for target in dataset.metadata["targets"]:
        column = TARGETS[target]
        for name, metric in METRICS.items():
            for seed, seed_predictions in predictions.groupby("seed"):
                true = truth.loc[seed_predictions["sample"], column]
                predicted = seed_predictions[column]
                rows.append((target, name, seed, metric(true.to_numpy(), predicted.to_numpy())))
    return pd.DataFrame(rows, columns=["target", "metric", "seed", "value"])


def unit(metric: str, target: str) -> str:
    """The unit of a metric of a target."""
    return "1" if metric == "r2" else UNITS[target]


def ensemble_errors(predictions: pd.DataFrame, dataset: Dataset) -> pd.DataFrame:
    """Rows of `by_seed`, without seed, for the mean of the seeds' predictions."""
    columns = [TARGETS[target] for target in dataset.metadata["targets"]]
    mean = predictions.groupby("sample", as_index=False)[columns].mean()
    return by_seed(mean.assign(seed=0), dataset).drop(columns="seed")


def evaluate(
    predictions: pd.DataFrame, dataset: Dataset, split: str, budget: str, header: dict
) -> pd.DataFrame:
    """Rows (COLUMNS) of each target and metric: `summary` of the seeds of `by_seed`, and
    `ensemble_errors`. Intervals hold the variation over seeds, not over recordings.

    `header`: of the model's file, with the number of training samples and of epochs.
    """
    metadata = dataset.metadata
    simulated = bool(metadata["configuration"])
    ensemble_values = ensemble_errors(predictions, dataset).set_index(["target", "metric"])["value"]
    rows = []
    for (target, name), seed_rows in by_seed(predictions, dataset).groupby(
        ["target", "metric"], sort=False
    ):
        rows.append(
            {
                "configuration": metadata["configuration"],
                "recording": "simulated" if simulated else metadata["name"],
                "origin": metadata["origin"],
                "split": split,
                "model": header["model"],
                "target": target,
                "metric": name,
                **summary(seed_rows["value"].to_numpy(), name),
                "ensemble": ensemble_values[target, name],
                "unit": unit(name, target),
                "budget": budget,
                "trained_samples": header["trained_samples"],
                "epochs": header["budget"]["epochs"],
                "tested_samples": predictions["sample"].nunique(),
            }
        )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def write(rows: pd.DataFrame, path: str | Path) -> None:
    """Write rows of `evaluate`, or of another table of errors, to a CSV file, atomically."""
    with atomic_path(path) as temporary:
        rows.to_csv(temporary, index=False)
