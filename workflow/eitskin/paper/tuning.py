"""Errors of models on the validation part at every point of a common grid."""

from pathlib import Path

import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.learn import models
from eitskin.paper.ablation import score, size

AXES = ("widths", "learning_rate", "weight_decay", "force_weight")
SHOWN = (("mae", "x"), ("mae", "y"), ("mae", "F"), ("r2", "F"))
TUNING = (
    *("dataset", "split", "budget", "model", *AXES, "seeds", "score"),
    *(f"{metric}_{target}" for metric, target in SHOWN),
    "best",
)


def row(rows: pd.DataFrame, model_columns: dict, point: dict, budget: str) -> dict:
    """A row (TUNING) of one point: its `ablation.score` and some means over seeds.

    rows: of `metrics.by_seed` on the validation part; model_columns: dataset, split and model;
    point: the values of AXES, widths for perceptrons only.
    """
    mean = rows.groupby(["metric", "target"])["value"].mean()
    means = {f"{metric}_{target}": mean.get((metric, target)) for metric, target in SHOWN}
    return {
        **{key: model_columns[key] for key in ("dataset", "split", "model")},
        **{key: point[key] for key in AXES if key != "widths"},
        "widths": size(point["widths"]) if models.model(model_columns["model"]).perceptron else "",
        "budget": budget,
        "seeds": rows["seed"].nunique(),
        "score": score(rows),
        **means,
    }


def write(rows: list[dict], path: str | Path) -> None:
    """Write the rows to a CSV file (columns TUNING), atomically; `best`: 1 for the best score of
    a model on its set and split, else 0."""
    table = pd.DataFrame(rows, columns=TUNING[:-1])
    best_score = table.groupby(["dataset", "split", "model"])["score"].transform("min")
    table["best"] = (table["score"] == best_score).astype(int)
    with atomic_path(path) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g")
