"""The figure of the closed loop: errors of force and place by the source of training samples."""

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eitskin import figure_files, plotting
from eitskin.learn.transfer_runs import TRAINED_FEW, ZERO_SHOT
from eitskin.plotting import AFTER, BEFORE, CENTRED, QUIET, log_ticks, style
from eitskin.quantities import power
from loop.naming import AUTHORS, BELIEF, DIAGNOSIS, LABELS, TRUTH
from loop.table import PLACE

MARKS = {  # colour, marker, words
    LABELS: ("#b8b8b8", "x", "the labelled frames alone"),
    BELIEF: (BEFORE, "o", "the owner's belief"),
    AUTHORS: ("#e69f00", "s", "the paper's perturbations"),
    DIAGNOSIS: (AFTER, "D", "the diagnosed simulator"),
    TRUTH: ("#202020", "|", "the true simulator"),
}
PANELS = {"F": "mean absolute error of F, N", PLACE: "mean absolute error of x and y, mm"}
ROWS = 0.32  # of a row, to each side of its middle, for the marks of the sources


def points(table: pd.DataFrame, model: str) -> pd.DataFrame:
    """The drawn rows of `table.summarise`: mean absolute errors of one model as trained."""
    rows = table[(table["model"] == model) & (table["metric"] == "mae")]
    rows = rows[rows["method"].isin([ZERO_SHOT, TRAINED_FEW]) & rows["variable"].isin(PANELS)]
    columns = ["case", "model", "source", "variable", "mean", "low", "high", "unit", "seeds"]
    return rows[columns].reset_index(drop=True)


def draw(table: pd.DataFrame) -> Figure:
    """One row for each case, with one mark for each source; bars are 95 % intervals over seeds."""
    cases = list(dict.fromkeys(table["case"]))
    with style():
        figure = plotting.sheet(plotting.FULL_MM, 26.0 + 7.0 * len(cases))
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (variable, title) in zip(panels, PANELS.items(), strict=True):
            variable_rows = table[table["variable"] == variable]
            for y, case in enumerate(cases):
                if case not in set(variable_rows["case"]):
                    centred = {"transform": axes.get_yaxis_transform(), **CENTRED}
                    axes.text(0.5, y, "not measured", color=QUIET, **centred)
            shifts = np.linspace(-ROWS, ROWS, len(MARKS))
            for (source, (colour, marker, words)), shift in zip(MARKS.items(), shifts, strict=True):
                source_rows = variable_rows[variable_rows["source"] == source]
                heights = [cases.index(case) + shift for case in source_rows["case"]]
                half = source_rows["mean"].to_numpy() - source_rows["low"].to_numpy()
                axes.errorbar(
                    source_rows["mean"],
                    heights,
                    xerr=np.nan_to_num(half),
                    fmt=marker,
                    color=colour,
                    markersize=3.5 if marker != "|" else 6.0,
                    elinewidth=0.8,
                    label=words,
                )
            axes.set_xscale("log")
            low, high = axes.get_xlim()
            log_ticks(axes.xaxis, low, high, power)
            axes.set_xlabel(title)
            axes.grid(axis="y", color=QUIET, alpha=0.3, linewidth=0.4)
        panels[0].set_yticks(range(len(cases)), _row_labels(cases))
        panels[0].invert_yaxis()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=5)
    return figure


def _row_labels(cases: list[str]) -> list[str]:
    """The cases' names without seeds, numbered from the second of equal ones."""
    names = [re.sub(r"-\d{6}$", "", case) for case in cases]
    count: Counter[str] = Counter()
    for k, name in enumerate(names):
        count[name] += 1
        names[k] = f"{name}, {count[name]}" if count[name] > 1 else name
    return names


def write(summary: Path, model: str, vector: Path, image: Path, csv: Path) -> None:
    """The figure of one model from the table of `table.write`: SVG, PNG, its numbers as CSV."""
    table = points(pd.read_csv(summary), model)
    figure_files.write(draw(table), table, vector, image, csv)
