"""Errors of the posterior mean, in the metrics of the models that it limits."""

import zlib

import numpy as np
import pandas as pd

from eitskin.data.dataset import Dataset
from eitskin.learn import metrics

TARGETS = {"x": "x_mm", "y": "y_mm", "F": "force_N"}
ESTIMATES = ("limit", "limit_known")  # skin and gains unknown, and known
COLUMNS = (
    *("configuration", "recording", "split", "estimate", "target", "metric"),
    *("value", "low", "high", "unit", "samples"),
)
RESAMPLES = 1000  # a 95 % limit to within some 0.5 % of probability
SEED = zlib.crc32(b"limit")


def score(estimates: pd.DataFrame, dataset: Dataset, split: str, seed: int) -> pd.DataFrame:
    """Rows (COLUMNS) of each estimate, target and metric: the value, and its 95 % bootstrap
    interval over sessions. `z2`: mean square of error / posterior sd, 1 where the sd is calibrated.
    """
    rows = []
    for name, table in estimates.groupby("estimate"):
        resamples = resampled_sessions(table, seed)
        for target, column in TARGETS.items():
            truth, mean, sd = (
                table[key].to_numpy() for key in (column, f"{column}_mean", f"{column}_sd")
            )
            pulls = (truth - mean) / sd
            for metric in (*metrics.METRICS, "z2"):
                resampled = [_value(metric, truth[k], mean[k], pulls[k]) for k in resamples]
                low, high = np.quantile(resampled, [0.025, 0.975])
                rows.append(
                    {
                        "configuration": dataset.metadata["configuration"],
                        "recording": "simulated",
                        "split": split,
                        "estimate": name,
                        "target": target,
                        "metric": metric,
                        "value": _value(metric, truth, mean, pulls),
                        "low": float(low),
                        "high": float(high),
                        "unit": "1" if metric == "z2" else metrics.unit(metric, target),
                        "samples": len(table),
                    }
                )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def resampled_sessions(table: pd.DataFrame, seed: int) -> list[np.ndarray]:
    """RESAMPLES arrays of rows of a table, its sessions drawn with replacement."""
    groups = list(table.groupby("session").indices.values())
    rng = np.random.default_rng([seed, SEED])
    return [
        np.concatenate([groups[k] for k in rng.integers(len(groups), size=len(groups))])
        for _ in range(RESAMPLES)
    ]


def _value(metric: str, truth: np.ndarray, mean: np.ndarray, pulls: np.ndarray) -> float:
    if metric == "z2":
        return float((pulls**2).mean())
    return metrics.METRICS[metric](truth, mean)
