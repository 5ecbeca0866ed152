"""How well the posterior mean did, in the metrics of the models that it limits."""

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
RESAMPLED = 1000
SEED = zlib.crc32(b"limit")


def score(found: pd.DataFrame, dataset: Dataset, split: str, seed: int) -> pd.DataFrame:
    """Rows (COLUMNS) of each estimate, target and metric: the value, and its 95 % bootstrap
    interval over whole sessions. `z2`: mean square of the errors over the posterior's sd, 1 where
    it is right about itself.
    """
    rows = []
    for name, table in found.groupby("estimate"):
        again = sessions_again(table, seed)
        for target, column in TARGETS.items():
            truth, mean, sd = (
                table[key].to_numpy() for key in (column, f"{column}_mean", f"{column}_sd")
            )
            pulls = (truth - mean) / sd
            for metric in (*metrics.METRICS, "z2"):
                found_again = [_value(metric, truth[k], mean[k], pulls[k]) for k in again]
                low, high = np.quantile(found_again, [0.025, 0.975])
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


def sessions_again(table: pd.DataFrame, seed: int) -> list[np.ndarray]:
    """Rows of a table, its sessions drawn again with replacement, RESAMPLED times."""
    groups = list(table.groupby("session").indices.values())
    rng = np.random.default_rng([seed, SEED])
    return [
        np.concatenate([groups[k] for k in rng.integers(len(groups), size=len(groups))])
        for _ in range(RESAMPLED)
    ]


def _value(metric: str, truth: np.ndarray, mean: np.ndarray, pulls: np.ndarray) -> float:
    if metric == "z2":
        return float((pulls**2).mean())
    return metrics.METRICS[metric](truth, mean)
