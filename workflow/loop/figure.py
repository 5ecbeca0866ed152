"""The figure of the closed loop: errors of force and place by what a model learned from."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eitskin import figure_files, plotting
from eitskin.learn.transfer_runs import TRAINED_FEW, ZERO_SHOT
from eitskin.plotting import AFTER, BEFORE, QUIET, log_ticks, style
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
PANELS = {"F": "mean absolute error of F, N", PLACE: "of x and y, mm"}


def points(table: pd.DataFrame, model: str) -> pd.DataFrame:
    """Rows of `table.summarise` that are drawn: mean absolute errors of one model as trained."""
    kept = table[(table["model"] == model) & (table["metric"] == "mae")]
    kept = kept[kept["method"].isin([ZERO_SHOT, TRAINED_FEW]) & kept["variable"].isin(PANELS)]
    columns = ["case", "model", "source", "variable", "mean", "low", "high", "unit", "seeds"]
    return kept[columns].reset_index(drop=True)


def draw(table: pd.DataFrame) -> Figure:
    """A row a case, a mark a source; bars are 95 % intervals over seeds."""
    cases = list(dict.fromkeys(table["case"]))
    with style():
        figure = plotting.sheet(plotting.FULL_MM, 26.0 + 7.0 * len(cases))
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (variable, title) in zip(panels, PANELS.items(), strict=True):
            for source, (colour, marker, words) in MARKS.items():
                own = table[(table["variable"] == variable) & (table["source"] == source)]
                at = [cases.index(case) for case in own["case"]]
                half = own["mean"].to_numpy() - own["low"].to_numpy()
                axes.errorbar(
                    own["mean"],
                    at,
                    xerr=np.nan_to_num(half),
                    fmt=marker,
                    color=colour,
                    markersize=4.0 if marker != "|" else 9.0,
                    elinewidth=0.8,
                    label=words,
                )
            axes.set_xscale("log")
            log_ticks(axes.xaxis, *axes.get_xlim(), power)
            axes.set_xlabel(title)
            axes.grid(axis="y", color=QUIET, alpha=0.3, linewidth=0.4)
        panels[0].set_yticks(range(len(cases)), cases)
        panels[0].invert_yaxis()
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=5)
    return figure


def write(summary: Path, model: str, vector: Path, image: Path, csv: Path) -> None:
    """The figure of one model, of the table that `table.write` wrote, as SVG and PNG, its numbers
    as CSV."""
    table = points(pd.read_csv(summary), model)
    figure_files.write(draw(table), table, vector, image, csv)
