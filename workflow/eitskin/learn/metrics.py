"""How far predictions are from the truth: per target, with intervals over seeds."""

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
LEAST_SEEDS = 5  # of which an interval is told; of fewer each seed's value speaks for itself


def r2(truth: np.ndarray, predicted: np.ndarray) -> float:
    """Coefficient of determination, 1 - Σ(s - ŝ)² / Σ(s - mean s)²; NaN where the truth is one."""
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
    """`interval` of values (n,), one a seed; NaN for fewer than LEAST_SEEDS."""
    return interval(values) if len(values) >= LEAST_SEEDS else (float("nan"), float("nan"))


def summary(values: np.ndarray, metric: str) -> dict:
    """What the seeds' values (n,) of a metric say: `mean`; `low` and `high` as of
    `interval_of_seeds`, within what the metric can be; `each` value, with semicolons; `seeds` n."""
    possible = (-np.inf, 1.0) if metric == "r2" else (0.0, np.inf)
    low, high = np.clip(interval_of_seeds(values), *possible).tolist()
    return {
        "mean": float(np.mean(values)),
        "low": low,
        "high": high,
        "each": ";".join(f"{value:.6g}" for value in values),
        "seeds": len(values),
    }


def by_seed(predictions: pd.DataFrame, dataset: Dataset) -> pd.DataFrame:
    """Columns target, metric, seed, value of each seed's predictions: sample, seed and the target
    columns, as `predict.predict_part` gives them. No frame is left out, abstained from or not.
    """
    truth = dataset.table.set_index("sample")
    rows = []
    for target in dataset.metadata["targets"]:
        column = TARGETS[target]
        for name, metric in METRICS.items():
            for seed, one in predictions.groupby("seed"):
                true, predicted = truth.loc[one["sample"], column], one[column]
                rows.append((target, name, seed, metric(true.to_numpy(), predicted.to_numpy())))
    return pd.DataFrame(rows, columns=["target", "metric", "seed", "value"])


def unit(metric: str, target: str) -> str:
    """The unit of a metric of a target."""
    return "1" if metric == "r2" else UNITS[target]


def of_ensemble(predictions: pd.DataFrame, dataset: Dataset) -> pd.DataFrame:
    """Rows of `by_seed`, without seed, of the mean over seeds of what they predict."""
    columns = [TARGETS[target] for target in dataset.metadata["targets"]]
    mean = predictions.groupby("sample", as_index=False)[columns].mean()
    return by_seed(mean.assign(seed=0), dataset).drop(columns="seed")


def evaluate(
    predictions: pd.DataFrame, dataset: Dataset, split: str, budget: str, header: dict
) -> pd.DataFrame:
    """Rows (COLUMNS) of each target and metric: `summary` of the seeds of `by_seed`, and
    `of_ensemble`. An interval tells what the seed does, not what another recording would.

    `header`: of the model's file, which says what it was trained on, and for how many epochs.
    """
    metadata = dataset.metadata
    simulated = bool(metadata["configuration"])
    together = of_ensemble(predictions, dataset).set_index(["target", "metric"])["value"]
    rows = []
    for (target, name), one in by_seed(predictions, dataset).groupby(
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
                **summary(one["value"].to_numpy(), name),
                "ensemble": together[target, name],
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
