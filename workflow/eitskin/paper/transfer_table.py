"""The table of transfers: means, intervals, and their reading in words."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from eitskin.atomic import atomic_path
from eitskin.data.dataset import TARGETS, UNITS
from eitskin.errors import InputError
from eitskin.learn.metrics import interval
from eitskin.learn.transfer_runs import (
    CONSTANT,
    FEW_LABELS,
    METHODS,
    NEAREST,
    NO_LABELS,
    RUNS,
    TRAINED_ALL,
    TRAINED_FEW,
    ZERO_SHOT,
)

KEYS = ("source", "target", "model", "budget")
TABLE = (
    *("source", "target", "model", "method", "labels", "labelled_frames", "variable", "metric"),
    *("mean", "low", "high", "unit", "draws", "seeds", "budget", "left_out"),
)
SHOWN = {"mae": "MAE", "r2": "R²"}
GROUP = [*KEYS, "method", "variable", "metric"]
REFERENCES = (CONSTANT, NEAREST, TRAINED_FEW, TRAINED_ALL)

Files = list[tuple[dict[str, str], str | Path]]  # keys of a file of runs, and the file


def collect(files: Files, keys: Sequence[str] = KEYS, table_name: str = "transfer") -> pd.DataFrame:
    """The runs of all files, preceded by the columns `keys`; a reference's source is empty.

    Raises InputError for a file with other columns and, in the name of `table_name`, without files.
    """
    if not files:
        raise InputError(table_name, "files of runs", "none", "at least one")
    tables = [
        read_runs(path).assign(**keys_of_file)[[*keys, *RUNS]] for keys_of_file, path in files
    ]
    return pd.concat(tables, ignore_index=True)


def read_runs(path: str | Path) -> pd.DataFrame:
    """The rows (`RUNS`) of a file. Raises InputError for other columns."""
    text = dict.fromkeys(("method", "variable", "metric", "left_out"), str)
    table = pd.read_csv(path, keep_default_na=False, na_values={"value": ""}, dtype=text)
    if list(table.columns) != list(RUNS):
        raise InputError(path, "columns", list(table.columns), f"{list(RUNS)}")
    return table


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """Rows (TABLE): mean and 95 % interval (Student's t) over draws of the labels, else over seeds.
    A method that was left out has its reason and no numbers."""
    rows = []
    for names, group in runs.groupby(GROUP, sort=False):
        row = dict(zip(GROUP, names, strict=True))
        row["labels"] = METHODS.get(row["method"], "")
        row["left_out"] = group["left_out"].iloc[0]
        if not row["left_out"]:
            row["mean"] = group["value"].mean()
            row["low"], row["high"] = interval(group["value"].to_numpy())
            row["labelled_frames"] = round(group["labelled_frames"].mean())
            row["unit"] = "1" if row["metric"] == "r2" else UNITS[row["variable"]]
            row["draws"] = group.loc[group["draw"] >= 0, "draw"].nunique()
            row["seeds"] = group.loc[group["seed"] >= 0, "seed"].nunique()
        rows.append(row)
    table = pd.DataFrame(rows, columns=list(TABLE))
    counts = ["labelled_frames", "draws", "seeds"]
    table[counts] = table[counts].astype("Int64")
    return table


def difference(runs_a: pd.DataFrame, runs_b: pd.DataFrame) -> tuple[float, float, float]:
    """Mean, low and high (95 %) of the values of `runs_a` minus those of `runs_b`, of two methods
    for one variable and metric.

    Student's t of pairs of the same draw, or of the same seed where the models are the same or no
    labels were drawn; otherwise Welch's t. The limits are NaN where one has a single run.
    """
    has_draws = [bool((runs["draw"] >= 0).all()) for runs in (runs_a, runs_b)]
    if has_draws[0] == has_draws[1]:
        key: str | None = "draw" if has_draws[0] else "seed"
    else:
        key = "seed" if set(runs_a["source"]) == set(runs_b["source"]) else None
    if key is not None:
        pairs = runs_a.merge(runs_b, on=key)
        values = (pairs["value_x"] - pairs["value_y"]).to_numpy()
        return float(values.mean()), *interval(values)
    samples = [runs["value"].to_numpy() for runs in (runs_a, runs_b)]
    mean = float(samples[0].mean() - samples[1].mean())
    if min(map(len, samples)) < 2:
        return mean, float("nan"), float("nan")
    limits = stats.ttest_ind(*samples, equal_var=False).confidence_interval(0.95)
    return mean, float(limits.low), float(limits.high)


def write(files: Files, csv: str | Path, markdown: str | Path) -> None:
    """Write the table to `csv` (columns TABLE) and to `markdown`, with a reading in words."""
    runs = collect(files)
    table = summarise(runs)
    with atomic_path(csv) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g")
    with atomic_path(markdown) as temporary:
        temporary.write_text(to_markdown(runs, table), encoding="utf-8")


def to_markdown(runs: pd.DataFrame, table: pd.DataFrame) -> str:
    """A section for each recording, model and budget: the references, the methods of every
    simulation, the omissions, and the reading of each variable by its mean absolute error."""
    lines = [
        "# Transfer from simulation to recording",
        "",
        "On the recording's test part (whole places held out), mean [95 % interval]: over draws of",
        "the labelled 5 %, the simulation's models taken in turn, or over the models' seeds where",
        "no label is used. The intervals hold neither another split nor another recording. x, y in",
        "mm, F in N. z-score and CORAL take it that both sets were pressed alike. What errs least",
        "of several was found on the same test part, and so looks a little better than it is.",
    ]
    for (target, model, budget), section in table.groupby(
        ["target", "model", "budget"], sort=False
    ):
        sources = [source for source in section["source"].unique() if source]
        lines += ["", f"## {target} · {model} · budget {budget}"]
        for source in sources:
            source_rows = section[section["source"].isin([source, ""])]
            shown_rows = source_rows[
                (source_rows["left_out"] == "") & source_rows["metric"].isin(SHOWN)
            ]
            known_variables = shown_rows.loc[shown_rows["source"] == source, "variable"].unique()
            shown_rows = shown_rows[shown_rows["variable"].isin(known_variables)]
            lines += ["", f"### From {source}", "", *_lines(shown_rows)]
            for row in source_rows[source_rows["left_out"] != ""].itertuples():
                omission = ", ".join(filter(None, [row.method, row.variable])) or "everything"
                lines.append(f"- left out, {omission}: {row.left_out}")
            error_runs = (runs["target"] == target) & (runs["model"] == model)
            error_runs &= (runs["budget"] == budget) & runs["source"].isin([source, ""])
            error_runs &= (runs["left_out"] == "") & (runs["metric"] == "mae")
            lines += [f"- {reading(runs[error_runs], v)}" for v in TARGETS if v in known_variables]
    return "\n".join(lines) + "\n"


def _lines(rows: pd.DataFrame) -> list[str]:
    if rows.empty:
        return []
    columns = [
        (variable, metric)
        for variable in TARGETS
        for metric in SHOWN
        if variable in set(rows["variable"])
    ]
    lines = [
        "| method | labels | "
        + " | ".join(f"{SHOWN[metric]} {variable}" for variable, metric in columns)
        + " |",
        "|---" * (len(columns) + 2) + "|",
    ]
    for method in METHODS:
        cells = rows[rows["method"] == method].set_index(["variable", "metric"])
        if cells.empty:
            continue
        texts = [_cell(cells.loc[c]) if c in cells.index else "" for c in columns]
        lines.append(f"| {method} | {METHODS[method]} | " + " | ".join(texts) + " |")
    return [*lines, ""]


def _cell(row: pd.Series) -> str:
    text = f"{row['mean']:.2f}"
    return text if np.isnan(row["low"]) else f"{text} [{row['low']:.2f}, {row['high']:.2f}]"


def reading(runs: pd.DataFrame, variable: str) -> str:
    """One variable's mean absolute errors in words, by intervals of differences: the simulation
    against a constant, each method without labels against zero-shot, the best with 5 % of the
    labels against zero-shot and the best reference of those labels, and the training part."""
    runs_by_method = {m: g for m, g in runs[runs["variable"] == variable].groupby("method")}
    error = {method: group["value"].mean() for method, group in runs_by_method.items()}
    unit, clauses = UNITS[variable], []

    def versus(method: str, reference: str) -> str:
        mean, low, high = difference(runs_by_method[method], runs_by_method[reference])
        word = "better than" if high < 0 else "worse than" if low > 0 else "not told apart from"
        limits = "" if np.isnan(low) else f" [{low:+.2f}, {high:+.2f}]"
        return f"{word} {reference} ({mean:+.2f} {unit}{limits})"

    def best_method(methods: list[str]) -> str | None:
        return min(
            (m for m in methods if m in runs_by_method), key=lambda m: error[m], default=None
        )

    if ZERO_SHOT in runs_by_method:
        text = f"zero-shot errs by {error[ZERO_SHOT]:.2f} {unit}"
        clauses.append(
            text + (f", {versus(ZERO_SHOT, CONSTANT)}" if CONSTANT in runs_by_method else "")
        )
        unlabelled = [
            m for m in METHODS if METHODS[m] == NO_LABELS and m in runs_by_method and m != ZERO_SHOT
        ]
        clauses += [f"{method} is {versus(method, ZERO_SHOT)}" for method in unlabelled]
    best = best_method([m for m in METHODS if METHODS[m] == FEW_LABELS and m not in REFERENCES])
    best_alone = best_method([CONSTANT, NEAREST, TRAINED_FEW])
    if best is not None:
        compared = [m for m in (ZERO_SHOT, best_alone) if m is not None and m in runs_by_method]
        best_clauses = [f"with 5 % of the labels {best} errs least, {error[best]:.2f} {unit}"]
        clauses.append(
            ", ".join(
                [*best_clauses, *(versus(best, compared_method) for compared_method in compared)]
            )
        )
    if best_alone is not None:
        clauses.append(f"the 5 % alone give {error[best_alone]:.2f} {unit} at best ({best_alone})")
    if TRAINED_ALL in runs_by_method:
        clauses.append(f"the whole training part {error[TRAINED_ALL]:.2f} {unit}")
    return f"**{variable}**: " + "; ".join(clauses) + "."
