"""The table of transfers: means, intervals, and what they say in words."""

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


def collect(files: Files, keys: Sequence[str] = KEYS, of: str = "transfer") -> pd.DataFrame:
    """The runs of all files with `keys` before them; a reference's source is empty.

    Raises InputError, with `of` as its file, where there are none, or where a file holds something
    else.
    """
    if not files:
        raise InputError(of, "files of runs", "none", "at least one")
    tables = [read_runs(path).assign(**given)[[*keys, *RUNS]] for given, path in files]
    return pd.concat(tables, ignore_index=True)


def read_runs(path: str | Path) -> pd.DataFrame:
    """The rows (`RUNS`) of a file. Raises InputError where it holds something else."""
    text = dict.fromkeys(("method", "variable", "metric", "left_out"), str)
    table = pd.read_csv(path, keep_default_na=False, na_values={"value": ""}, dtype=text)
    if list(table.columns) != list(RUNS):
        raise InputError(path, "columns", list(table.columns), f"{list(RUNS)}")
    return table


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """Rows (TABLE): mean and 95 % interval (Student's t) over draws of the labels, else over seeds;
    what was left out comes with its reason and without numbers."""
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


def difference(one: pd.DataFrame, other: pd.DataFrame) -> tuple[float, float, float]:
    """Mean, low and high (95 %) of the values of `one` minus those of `other`, runs of one variable
    and metric by two methods.

    Student's t of pairs: of the same draw, or of the same seed where the models are the same or
    nothing was drawn. Welch's t where nothing pairs them. NaN limits where one has a single run.
    """
    drawn = [bool((runs["draw"] >= 0).all()) for runs in (one, other)]
    if drawn[0] == drawn[1]:
        key: str | None = "draw" if drawn[0] else "seed"
    else:
        key = "seed" if set(one["source"]) == set(other["source"]) else None
    if key is not None:
        pairs = one.merge(other, on=key)
        values = (pairs["value_x"] - pairs["value_y"]).to_numpy()
        return float(values.mean()), *interval(values)
    found = [runs["value"].to_numpy() for runs in (one, other)]
    mean = float(found[0].mean() - found[1].mean())
    if min(map(len, found)) < 2:
        return mean, float("nan"), float("nan")
    limits = stats.ttest_ind(*found, equal_var=False).confidence_interval(0.95)
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
    """A section for each recording, model and budget: its references, every simulation's methods,
    what was left out, and the reading of each variable by its mean absolute error."""
    lines = [
        "# Transfer from simulation to recording",
        "",
        "On the recording's test part (whole places held out), mean [95 % interval]: over draws of",
        "the labelled 5 %, the simulation's models taken in turn, or over the models' seeds where",
        "no label is used. The intervals hold neither another split nor another recording. x, y in",
        "mm, F in N. z-score and CORAL take it that both sets were pressed alike. What errs least",
        "of several was found on the same test part, and so looks a little better than it is.",
    ]
    for (target, model, budget), part in table.groupby(["target", "model", "budget"], sort=False):
        sources = [source for source in part["source"].unique() if source]
        lines += ["", f"## {target} · {model} · budget {budget}"]
        for source in sources:
            here = part[part["source"].isin([source, ""])]
            kept = here[(here["left_out"] == "") & here["metric"].isin(SHOWN)]
            known = kept.loc[kept["source"] == source, "variable"].unique()
            kept = kept[kept["variable"].isin(known)]
            lines += ["", f"### From {source}", "", *_lines(kept)]
            for row in here[here["left_out"] != ""].itertuples():
                what = ", ".join(filter(None, [row.method, row.variable])) or "everything"
                lines.append(f"- left out, {what}: {row.left_out}")
            own = (runs["target"] == target) & (runs["model"] == model)
            own &= (runs["budget"] == budget) & runs["source"].isin([source, ""])
            own &= (runs["left_out"] == "") & (runs["metric"] == "mae")
            lines += [f"- {reading(runs[own], v)}" for v in TARGETS if v in known]
    return "\n".join(lines) + "\n"


def _lines(kept: pd.DataFrame) -> list[str]:
    if kept.empty:
        return []
    columns = [(v, m) for v in TARGETS for m in SHOWN if v in set(kept["variable"])]
    lines = [
        "| method | labels | " + " | ".join(f"{SHOWN[m]} {v}" for v, m in columns) + " |",
        "|---" * (len(columns) + 2) + "|",
    ]
    for method in METHODS:
        cells = kept[kept["method"] == method].set_index(["variable", "metric"])
        if cells.empty:
            continue
        texts = [_cell(cells.loc[c]) if c in cells.index else "" for c in columns]
        lines.append(f"| {method} | {METHODS[method]} | " + " | ".join(texts) + " |")
    return [*lines, ""]


def _cell(row: pd.Series) -> str:
    text = f"{row['mean']:.2f}"
    return text if np.isnan(row["low"]) else f"{text} [{row['low']:.2f}, {row['high']:.2f}]"


def reading(runs: pd.DataFrame, variable: str) -> str:
    """What one variable's mean absolute errors say, by intervals of differences: the simulation
    against a constant, each method without labels against zero-shot, the best with 5 % against
    zero-shot and the best that those labels give alone, and what the whole training part gives."""
    of = {m: g for m, g in runs[runs["variable"] == variable].groupby("method")}
    error = {method: group["value"].mean() for method, group in of.items()}
    unit, said = UNITS[variable], []

    def versus(one: str, other: str) -> str:
        mean, low, high = difference(of[one], of[other])
        word = "better than" if high < 0 else "worse than" if low > 0 else "not told apart from"
        limits = "" if np.isnan(low) else f" [{low:+.2f}, {high:+.2f}]"
        return f"{word} {other} ({mean:+.2f} {unit}{limits})"

    def least(methods: list[str]) -> str | None:
        return min((m for m in methods if m in of), key=lambda m: error[m], default=None)

    if ZERO_SHOT in of:
        text = f"zero-shot errs by {error[ZERO_SHOT]:.2f} {unit}"
        said.append(text + (f", {versus(ZERO_SHOT, CONSTANT)}" if CONSTANT in of else ""))
        unlabelled = [m for m in METHODS if METHODS[m] == NO_LABELS and m in of and m != ZERO_SHOT]
        said += [f"{method} is {versus(method, ZERO_SHOT)}" for method in unlabelled]
    best = least([m for m in METHODS if METHODS[m] == FEW_LABELS and m not in REFERENCES])
    alone = least([CONSTANT, NEAREST, TRAINED_FEW])
    if best is not None:
        others = [m for m in (ZERO_SHOT, alone) if m is not None and m in of]
        told = [f"with 5 % of the labels {best} errs least, {error[best]:.2f} {unit}"]
        said.append(", ".join([*told, *(versus(best, other) for other in others)]))
    if alone is not None:
        said.append(f"the 5 % alone give {error[alone]:.2f} {unit} at best ({alone})")
    if TRAINED_ALL in of:
        said.append(f"the whole training part {error[TRAINED_ALL]:.2f} {unit}")
    return f"**{variable}**: " + "; ".join(said) + "."
