"""Figure 4: predicted against true force of the worst and the best model; errors over the skin."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.spatial import cKDTree

from eitskin import figure_files, plotting
from eitskin.data import parquet
from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.learn.metrics import METRICS
from eitskin.plotting import BEFORE, SEQUENTIAL, STEPS, log_ticks, style
from eitskin.quantities import number, power

BINS = 50  # of force, each way
SHOWN = 0.98  # of the places lie within the colours of panel c
ACROSS = 320  # pixels over the disc of panel c


@dataclass(frozen=True)
class Chosen:
    """The model with the largest and the one with the smallest error of force, of `models`."""

    worst: str
    best: str
    models: tuple[str, ...]


def choose(metrics: dict[str, pd.DataFrame]) -> Chosen:
    """By the mean absolute error of the force on the test part, mean over the seeds, of metrics
    (model: rows of `metrics.evaluate`): as Table I has it. Of equals the first.

    Nothing is learned from the choice; the best is the best of these on this test part. Raises
    InputError where there are not two models or one has no such error.
    """
    error = {}
    for model, rows in metrics.items():
        own = rows[(rows["target"] == "F") & (rows["metric"] == "mae")]["mean"]
        if len(own) != 1 or not np.isfinite(own.iloc[0]):
            raise InputError(f"metrics of {model}", "mae of F", f"{len(own)} of them", "one number")
        error[model] = float(own.iloc[0])
    if len(error) < 2:
        raise InputError("config.yaml", "models", ", ".join(error) or "none", "two or more to draw")
    order = sorted(error, key=lambda model: error[model])
    return Chosen(order[-1], order[0], tuple(error))


def joined(predictions: pd.DataFrame, dataset: Dataset, model: str) -> pd.DataFrame:
    """Every seed's test samples: model, seed, sample, place, x_mm, y_mm, force_N, predicted_N."""
    truth = dataset.table[["sample", "place", "x_mm", "y_mm", "force_N"]]
    found = predictions[["sample", "seed", "force_N"]].rename(columns={"force_N": "predicted_N"})
    table = found.merge(truth, on="sample", how="left", validate="many_to_one")
    table.insert(0, "model", model)
    columns = ["model", "seed", "sample", "place", "x_mm", "y_mm", "force_N", "predicted_N"]
    return table[columns].sort_values(["seed", "sample"], ignore_index=True)


def by_place(table: pd.DataFrame) -> pd.DataFrame:
    """place, x_mm, y_mm, mae_N and samples, of rows of `joined`: mean absolute error of the force
    over every seed; positions are means."""
    error = (table["predicted_N"] - table["force_N"]).abs()
    groups = table.assign(mae_N=error).groupby("place")
    mean = groups[["x_mm", "y_mm", "mae_N"]].mean()
    return mean.assign(samples=groups.size()).reset_index()


def draw(
    worst: pd.DataFrame, best: pd.DataFrame, radius_mm: float, electrode_deg: np.ndarray
) -> Figure:
    """Panels a, b: counts of test samples, of the first seed, by true and predicted force; c: the
    best model's error, each spot of the skin in the colour of the tested place nearest to it."""
    first = [table[table["seed"] == table["seed"].min()] for table in (worst, best)]
    values = pd.concat(first)[["force_N", "predicted_N"]].to_numpy()
    low, high = min(0.0, values.min()), values.max()
    edges = np.linspace(low, high, BINS + 1)
    colours = matplotlib.colormaps[SEQUENTIAL]
    with style():
        figure = plotting.sheet(plotting.FULL_MM, 62.0)
        axes = figure.subplots(1, 3)
        counts = [
            np.histogram2d(table["force_N"], table["predicted_N"], bins=(edges, edges))[0]
            for table in first
        ]
        most = max(2.0, max(count.max() for count in counts))
        norm = LogNorm(0.8, most)
        for panel, letter, table, count in zip(axes, "ab", first, counts, strict=False):
            drawn = panel.pcolormesh(
                edges,
                edges,
                np.ma.masked_equal(count.T, 0),
                cmap=colours,
                norm=norm,
                rasterized=True,
            )
            panel.plot([low, high], [low, high], color=BEFORE, linewidth=0.8)
            truth, predicted = table["force_N"].to_numpy(), table["predicted_N"].to_numpy()
            r2, mae = (METRICS[name](truth, predicted) for name in ("r2", "mae"))
            panel.text(
                0.04, 0.96, f"R² {number(r2)}\nMAE {mae:.2f} N", transform=panel.transAxes, va="top"
            )
            panel.set_title(
                f"({letter}) {'worst' if letter == 'a' else 'best'}: {table['model'].iloc[0]}"
            )
            panel.set(xlim=(low, high), ylim=(low, high), aspect="equal")
            panel.set_xlabel("true force, N")
            for axis in (panel.xaxis, panel.yaxis):
                axis.set_major_locator(MaxNLocator(5, integer=True))
        axes[0].set_ylabel("predicted force, N")
        log_ticks(_bar(figure, drawn, axes[:2], "test samples").ax.xaxis, 0.8, most, power)
        _draw_places(figure, axes[2], best, radius_mm, electrode_deg)
    return figure


def _draw_places(
    figure: Figure, axes: Axes, best: pd.DataFrame, radius_mm: float, electrode_deg: np.ndarray
) -> None:
    places = by_place(best)
    largest = float(places["mae_N"].quantile(SHOWN))
    plotting.disc(axes, radius_mm, electrode_deg)
    at = places[["x_mm", "y_mm"]].to_numpy()
    edge = radius_mm * np.linspace(-1.0, 1.0, ACROSS + 1)
    spot = np.stack(np.meshgrid(0.5 * (edge[1:] + edge[:-1]), 0.5 * (edge[1:] + edge[:-1])), -1)
    shown = places["mae_N"].to_numpy()[cKDTree(at).query(spot)[1]]
    drawn = axes.pcolormesh(
        edge,
        edge,
        np.ma.masked_where(np.linalg.norm(spot, axis=-1) > radius_mm, shown),
        norm=Normalize(0.0, largest),
        cmap=matplotlib.colormaps[SEQUENTIAL].resampled(STEPS),
        rasterized=True,
    )
    axes.plot(*at.T, ".", color="white", mew=0, markersize=min(2.0, 20 / np.sqrt(len(at))))
    plotting.leave_room(axes, radius_mm)
    axes.set_title(f"(c) {best['model'].iloc[0]}, by place")
    axes.set_xlabel("x, mm")
    axes.set_ylabel("y, mm")
    extend = "max" if places["mae_N"].max() > largest else "neither"
    label = f"mean |error of force|, N; largest {places['mae_N'].max():.2f}"
    _bar(figure, drawn, axes, label, extend)


def _bar(
    figure: Figure, drawn: ScalarMappable, axes: Axes, label: str, extend: str = "neither"
) -> Colorbar:
    bar = figure.colorbar(drawn, ax=axes, location="bottom", aspect=35, shrink=0.8, extend=extend)
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)
    return bar


def write(
    metrics: dict[str, pd.DataFrame],
    predictions: dict[str, str | Path],
    dataset: Dataset,
    radius_mm: float,
    electrode_deg: np.ndarray,
    vector: Path,
    image: Path,
    csv: Path,
) -> Chosen:
    """Figure 4 of one dataset and split from every model's metrics and predictions (files by
    model); the CSV holds the two models' test samples of every seed."""
    chosen = choose(metrics)
    worst, best = (
        joined(parquet.frame(parquet.read(predictions[model])), dataset, model)
        for model in (chosen.worst, chosen.best)
    )
    table = pd.concat([worst.assign(panel="a"), best.assign(panel="b, c")], ignore_index=True)
    figure_files.write(draw(worst, best, radius_mm, electrode_deg), table, vector, image, csv)
    return chosen
