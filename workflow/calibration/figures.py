"""The calibration's figures: who is taken for whom, and whether "other" means its probability."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eitskin.atomic import atomic_path
from eitskin.plotting import AFTER, PLAIN, QUIET, SEQUENTIAL, WIDTH_IN, png, style, svg

NO_NAME = ("several", "nothing")


def confusion(table: pd.DataFrame) -> Figure:
    """Single effects far from every other name (truth, called, apart): counts, in the colour of
    their share of the row."""
    kept = table[table["apart"] > 0]
    truths = sorted(kept["truth"].unique())
    names = sorted((set(kept["called"]) | set(truths)) - set(NO_NAME))
    columns = [*names, *NO_NAME]
    counts = np.full((len(truths), len(columns)), np.nan)
    for line in kept.itertuples():
        counts[truths.index(line.truth), columns.index(line.called)] = line.apart
    with style():
        figure = Figure(figsize=(2 * WIDTH_IN, 0.55 + 2 * WIDTH_IN * max(len(truths), 8) / 42))
        axes = figure.add_subplot()
        if not truths:
            axes.text(0.5, 0.5, "no recordings", ha="center", va="center")
            axes.set_axis_off()
            return figure
        of = np.nansum(counts, axis=1)
        share = counts / of[:, None]
        axes.imshow(share, cmap=SEQUENTIAL, vmin=0, vmax=1, aspect="auto")
        for row, column in zip(*np.nonzero(np.isfinite(counts)), strict=True):
            colour = "black" if share[row, column] > 0.5 else "white"
            text = f"{counts[row, column]:.0f}"
            axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=5.5)
        axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=5.5)
        rows = [f"{truth} ({count:.0f})" for truth, count in zip(truths, of, strict=True)]
        axes.set_yticks(range(len(truths)), rows, fontsize=5.5)
        axes.set_xlabel("called (own name: right, or in the declared class)")
        axes.set_ylabel("left out")
        axes.grid(color=QUIET, linewidth=0.2, alpha=0.4)
        axes.set_axisbelow(True)
    return figure


def reliability(table: pd.DataFrame) -> Figure:
    """Stated probability against the share that it came true in, with the share's interval."""
    kept = table[table["n"] > 0]
    with style():
        figure = Figure(figsize=(WIDTH_IN, WIDTH_IN))
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8, linestyle="--")
        shares(axes, kept, "probability")
        for line in kept.itertuples():
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


def write(folder: Path) -> None:
    """Draw confusion.csv and other_calibration.csv of a folder beside them, as .svg and .png."""
    beside_tables({"confusion": confusion, "other_calibration": reliability}, folder)


def beside_tables(figures: dict[str, Callable[[pd.DataFrame], Figure]], folder: Path) -> None:
    """Draw each name.csv of a folder by the function of its name, as name.svg and name.png."""
    for name, draw in figures.items():
        figure = draw(pd.read_csv(folder / f"{name}.csv"))
        with atomic_path(folder / f"{name}.svg") as path:
            path.write_text(svg(figure), "utf-8")
        with atomic_path(folder / f"{name}.png") as path:
            path.write_bytes(png(figure))
