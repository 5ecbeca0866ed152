"""Figures of a block's score, each drawn from one of its tables."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from eitskin.atomic import atomic_path
from eitskin.plotting import (
    AFTER,
    BEFORE,
    COLUMN_MM,
    PLAIN,
    QUIET,
    SEQUENTIAL,
    WIDTH_IN,
    png,
    sheet,
    style,
    svg,
)
from eitskin.quantities import MINUS, number

NO_NAME = ("several", "nothing")


def confusion(table: pd.DataFrame) -> Figure:
    """Single effects far from every other name (truth, called, apart): counts, in the colour of
    their share of the row."""
    apart = table[table["apart"] > 0]
    truths = sorted(apart["truth"].unique())
    names = sorted((set(apart["called"]) | set(truths)) - set(NO_NAME))
    columns = [*names, *NO_NAME]
    counts = np.full((len(truths), len(columns)), np.nan)
    for line in apart.itertuples():
        counts[truths.index(line.truth), columns.index(line.called)] = line.apart
    with style():
        figure = Figure(figsize=(2 * WIDTH_IN, 0.55 + 2 * WIDTH_IN * max(len(truths), 8) / 42))
        axes = figure.add_subplot()
        if not truths:
            axes.text(0.5, 0.5, "no recordings", ha="center", va="center")
            axes.set_axis_off()
            return figure
        totals = np.nansum(counts, axis=1)
        share = counts / totals[:, None]
        axes.imshow(share, cmap=SEQUENTIAL, vmin=0, vmax=1, aspect="auto")
        for row, column in zip(*np.nonzero(np.isfinite(counts)), strict=True):
            colour = "black" if share[row, column] > 0.5 else "white"
            text = f"{counts[row, column]:.0f}"
            axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=5.5)
        axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=5.5)
        rows = [f"{truth} ({count:.0f})" for truth, count in zip(truths, totals, strict=True)]
        axes.set_yticks(range(len(truths)), rows, fontsize=5.5)
        axes.set_xlabel("called (own name: right, or in the declared class)")
        axes.set_ylabel("left out")
        axes.grid(color=QUIET, linewidth=0.2, alpha=0.4)
        axes.set_axisbelow(True)
    return figure


def reliability(table: pd.DataFrame) -> Figure:
    """Stated probability against the share that it came true in, with the share's interval."""
    bins = table[table["n"] > 0]
    with style():
        figure = Figure(figsize=(WIDTH_IN, WIDTH_IN))
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8, linestyle="--")
        shares(axes, bins, "probability")
        for line in bins.itertuples():
            above: dict[str, Any] = {"xytext": (0, 3), "textcoords": "offset points"}
            above |= {"ha": "center", "va": "bottom", "fontsize": 6.5, "bbox": PLAIN}
            axes.annotate(f"{line.n}", (line.probability, line.high), **above)
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.08), aspect="equal")
        axes.set_xlabel("probability stated that something is outside the catalogue")
        axes.set_ylabel("share of recordings where something is")
    return figure


def shares(axes: Axes, table: pd.DataFrame, along: str) -> None:
    """Points of a table's shares with their intervals, low to high where there are any, along one
    of its columns."""
    ends = np.array([table["share"] - table["low"], table["high"] - table["share"]])
    axes.errorbar(
        table[along],
        table["share"],
        yerr=ends.clip(0.0),
        fmt="o",
        color=AFTER,
        markersize=3,
        capsize=2,
        linewidth=0.8,
    )


COLOURS = {
    "eitskin": AFTER,
    "matched-filter": BEFORE,
    "lasso": "#009e73",
    "everything": "#cc79a7",
}
MARKERS = dict(zip(COLOURS, "os^D", strict=True))
LEAST_CLOSED = -1.0  # of the figure; what is less stands at its edge, as an arrow
LEAST_P = 5e-4  # of the figure; a share of 0 stands there, as a triangle


def accuracy(table: pd.DataFrame) -> Figure:
    """Right names of single effects against the gap, by method, under the ceiling Φ(gap / 2)."""
    with style():
        figure = sheet(COLUMN_MM, 62)
        axes = figure.add_subplot()
        gaps = np.geomspace(1.5, 60, 200)
        dashed: dict[str, Any] = {"color": QUIET, "linestyle": "--", "linewidth": 0.9}
        axes.plot(gaps, norm.cdf(0.5 * gaps), **dashed, label="ceiling")
        for k, (method, points) in enumerate(table.groupby("method", sort=False)):
            points = points.sort_values("gap")
            ends = np.array(
                [points["right"] - points["low"], points["high"] - points["right"]]
            ).clip(0.0)
            axes.errorbar(
                points["gap"] * 1.03 ** (k - 1.5),
                points["right"],
                yerr=ends,
                color=COLOURS[method],
                marker=MARKERS[method],
                markersize=3,
                capsize=1.5,
                linewidth=1.4 if method == "eitskin" else 0.8,
                elinewidth=0.6,
                label=method,
                zorder=3 if method == "eitskin" else 2,
            )
        axes.set_xscale("log")
        axes.set_xticks([2, 3, 5, 8, 12, 20, 40], ["2", "3", "5", "8", "12", "20", "40"])
        axes.minorticks_off()
        axes.set(xlim=(1.5, 60), ylim=(-0.02, 1.05))
        axes.set_xlabel("gap to the nearest other name, in units of the noise (median)")
        axes.set_ylabel("right name or declared class")
        figure.legend(loc="outside upper center", ncols=3, columnspacing=1.2, handlelength=1.4)
    return figure


def misfit_closed(table: pd.DataFrame) -> Figure:
    """How much of the misfit on hidden frames each method closes: every case, how many lie off the
    figure, and the median, a bar, or where it lies off an arrow with its number."""
    methods = list(reversed(dict.fromkeys(table["method"])))
    rng = np.random.default_rng(1)
    with style():
        figure = sheet(COLUMN_MM, 12 + 7 * max(len(methods), 2))
        axes = figure.add_subplot()
        for end, colour in ((0.0, BEFORE), (1.0, QUIET)):
            axes.axvline(end, color=colour, linewidth=0.8, linestyle="--")
        for y, method in enumerate(methods):
            values = table.loc[table["method"] == method, "misfit_closed"].dropna().to_numpy()
            clipped = np.maximum(values, LEAST_CLOSED)
            lift = y + rng.uniform(-0.22, 0.22, len(values))
            colour = COLOURS.get(method, "#404040")
            below_axis = values < LEAST_CLOSED
            axes.plot(
                clipped[~below_axis],
                lift[~below_axis],
                ".",
                color=colour,
                markersize=3,
                alpha=0.5,
                mew=0,
            )
            axes.plot(
                clipped[below_axis],
                lift[below_axis],
                "<",
                color=colour,
                markersize=3,
                alpha=0.5,
                mew=0,
            )
            if below_axis.any():
                text = f"{below_axis.sum()} below {MINUS}1"
                axes.text(LEAST_CLOSED, y + 0.38, text, color=colour, va="center", fontsize=6)
            if len(values):
                middle = float(np.median(values))
                if middle >= LEAST_CLOSED:
                    ends = [y - 0.34, y + 0.34]
                    axes.plot([middle] * 2, ends, color=colour, linewidth=2, zorder=1)
                else:
                    axes.annotate(
                        f"median {number(middle)}",
                        (LEAST_CLOSED - 0.05, y),
                        (LEAST_CLOSED + 0.2, y),
                        color=colour,
                        va="center",
                        bbox=PLAIN,
                        arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.5},
                    )
        axes.set_yticks(range(len(methods)), methods)
        axes.set_xticks([-1, -0.5, 0, 0.5, 1])
        axes.set(xlim=(LEAST_CLOSED - 0.05, 1.15), ylim=(-0.6, len(methods) - 0.4))
        meaning = "0: owner's simulation, calibrated; 1: true effects fitted"
        axes.set_xlabel(f"misfit closed on hidden frames\n({meaning})")
    return figure


def p_values(table: pd.DataFrame) -> Figure:
    """The share of p-values up to p, where nothing is concealed; a triangle where it is 0."""
    with style():
        figure = sheet(COLUMN_MM, COLUMN_MM)
        axes = figure.add_subplot()
        axes.plot([LEAST_P, 1], [LEAST_P, 1], color=QUIET, linewidth=0.8, linestyle="--")
        counted = table[table["n"] > 0]
        shares(axes, counted[counted["share"] > 0], "p")
        zero_p = counted.loc[counted["share"] == 0, "p"]
        axes.plot(
            zero_p, np.full(len(zero_p), LEAST_P), "v", color=AFTER, markersize=4, clip_on=False
        )
        if (table["n"] == 1).any():
            axes.text(0.03, 0.95, "one recording: no interval", transform=axes.transAxes)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set(xlim=(LEAST_P, 1.2), ylim=(LEAST_P, 1.2), aspect="equal")
        axes.set_xlabel("p-value of the atlas, nothing concealed")
        axes.set_ylabel("share of statistics with this p-value or less")
    return figure


FIGURES: dict[str, Callable[[pd.DataFrame], Figure]] = {
    "accuracy": accuracy,
    "misfit_closed": misfit_closed,
    "confusion": confusion,
    "reliability": reliability,
    "other_calibration": reliability,
    "p_values": p_values,
}


def write(folder: Path, names: Iterable[str]) -> None:
    """Draw tables name.csv of a folder, by the function of FIGURES, as name.svg and name.png."""
    for name in names:
        figure = FIGURES[name](pd.read_csv(folder / f"{name}.csv"))
        with atomic_path(folder / f"{name}.svg") as path:
            path.write_text(svg(figure), "utf-8")
        with atomic_path(folder / f"{name}.png") as path:
            path.write_bytes(png(figure))
