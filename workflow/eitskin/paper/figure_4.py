"""Figure 4: predicted against true force of the worst model and of one beside it; the latter's
errors over the skin."""

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

from eitskin import figure_files, plotting, skin_layout
from eitskin.data import parquet
from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.learn.metrics import METRICS
from eitskin.physics.skin import Skin
from eitskin.plotting import BEFORE, SEQUENTIAL, STEPS, log_ticks, style
from eitskin.quantities import number, power

BEST = "best"  # as the name of a model: that with the smallest error
BINS = 50  # of force, in each direction
SHOWN = 0.98  # of the places lie within the colours of panel c
ACROSS = 320  # pixels over the disc of panel c: half a millimetre of an 80 mm skin


@dataclass(frozen=True)
class Choice:
    """The models with the largest and with the smallest error of force among `models`, and the one
    that is `shown` beside the worst."""

    worst: str
    best: str
    shown: str
    models: tuple[str, ...]
    is_shown_worst: bool = False

    @property
    def remarks(self) -> tuple[str, str]:
        """What the panels a and b say of their models' errors of force, among all models."""
        if self.shown == self.best:
            return "worst", "best"
        if self.is_shown_worst:
            return "worst of the others", f"worst of all; best: {self.best}"
        return "worst", f"best: {self.best}"


def choose(metrics: dict[str, pd.DataFrame], shown: str = BEST) -> Choice:
    """The worst and the best model by the mean absolute error of the force on the test part, mean
    over the seeds, from rows of `metrics.evaluate` by model; the first of equal ones. `shown`: the
    model to show, which is not the worst then; the best where it is BEST or none of the models.

    The choice is for the drawing alone: it is made on the test part. Raises InputError for fewer
    than two models, or a model without such an error.
    """
    error = {}
    for model, rows in metrics.items():
        force_errors = rows[(rows["target"] == "F") & (rows["metric"] == "mae")]["mean"]
        if len(force_errors) != 1 or not np.isfinite(force_errors.iloc[0]):
            raise InputError(
                f"metrics of {model}", "mae of F", f"{len(force_errors)} of them", "one number"
            )
        error[model] = float(force_errors.iloc[0])
    if len(error) < 2:
        raise InputError("config.yaml", "models", ", ".join(error) or "none", "two or more to draw")
    order = sorted(error, key=lambda model: error[model])
    beside = shown if shown in error else order[0]
    worst = next(model for model in reversed(order) if model != beside)
    return Choice(worst, order[0], beside, tuple(error), is_shown_worst=order[-1] == beside)


def joined(predictions: pd.DataFrame, dataset: Dataset, model: str) -> pd.DataFrame:
    """Test samples of every seed: model, seed, sample, place, x_mm, y_mm, force_N, predicted_N."""
    truth = dataset.table[["sample", "place", "x_mm", "y_mm", "force_N"]]
    predicted = predictions[["sample", "seed", "force_N"]].rename(
        columns={"force_N": "predicted_N"}
    )
    table = predicted.merge(truth, on="sample", how="left", validate="many_to_one")
    table.insert(0, "model", model)
    columns = ["model", "seed", "sample", "place", "x_mm", "y_mm", "force_N", "predicted_N"]
    return table[columns].sort_values(["seed", "sample"], ignore_index=True)


def by_place(table: pd.DataFrame) -> pd.DataFrame:
    """place, x_mm, y_mm, mae_N and samples, from rows of `joined`: the mean absolute error of the
    force over all seeds, and mean positions."""
    error = (table["predicted_N"] - table["force_N"]).abs()
    groups = table.assign(mae_N=error).groupby("place")
    mean = groups[["x_mm", "y_mm", "mae_N"]].mean()
    return mean.assign(samples=groups.size()).reset_index()


def draw(
    worst: pd.DataFrame,
    shown: pd.DataFrame,
    skin: Skin,
    remarks: tuple[str, str] = ("worst", "best"),
) -> Figure:
    """Panels a, b: counts of test samples of the first seed by true and predicted force; c: the
    error of the model of b, every pixel of the skin in the colour of the nearest tested place.
    remarks: of `Choice`."""
    first_seed = [table[table["seed"] == table["seed"].min()] for table in (worst, shown)]
    values = pd.concat(first_seed)[["force_N", "predicted_N"]].to_numpy()
    low, high = min(0.0, values.min()), values.max()
    edges = np.linspace(low, high, BINS + 1)
    colours = matplotlib.colormaps[SEQUENTIAL]
    with style():
        figure = plotting.sheet(plotting.FULL_MM, 62.0)
        axes = figure.subplots(1, 3)
        counts = [
            np.histogram2d(table["force_N"], table["predicted_N"], bins=(edges, edges))[0]
            for table in first_seed
        ]
        largest_count = max(2.0, max(count.max() for count in counts))
        norm = LogNorm(0.8, largest_count)
        for panel, letter, remark, table, count in zip(
            axes, "ab", remarks, first_seed, counts, strict=False
        ):
            mesh = panel.pcolormesh(
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
            panel.set_title(f"({letter}) {table['model'].iloc[0]}\n({remark})")
            panel.set(xlim=(low, high), ylim=(low, high), aspect="equal")
            panel.set_xlabel("true force, N")
            for axis in (panel.xaxis, panel.yaxis):
                axis.set_major_locator(MaxNLocator(5, integer=True))
        axes[0].set_ylabel("predicted force, N")
        log_ticks(_bar(figure, mesh, axes[:2], "test samples").ax.xaxis, 0.8, largest_count, power)
        _draw_places(figure, axes[2], shown, skin)
    return figure


def _draw_places(figure: Figure, axes: Axes, shown: pd.DataFrame, skin: Skin) -> None:
    places = by_place(shown)
    largest = float(places["mae_N"].quantile(SHOWN))
    layout = skin_layout.draw(axes, skin)
    place_mm = places[["x_mm", "y_mm"]].to_numpy()
    edge = layout.half_extent_mm * np.linspace(-1.0, 1.0, ACROSS + 1)
    x, y = layout.centre.real + edge, layout.centre.imag + edge
    spot = np.stack(np.meshgrid(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])), -1)
    pixel_errors = places["mae_N"].to_numpy()[cKDTree(place_mm).query(spot)[1]]
    is_beyond = skin_layout.is_beyond(skin, spot[..., 0] + 1j * spot[..., 1])
    mesh = axes.pcolormesh(
        x,
        y,
        np.ma.masked_where(is_beyond, pixel_errors),
        norm=Normalize(0.0, largest),
        cmap=matplotlib.colormaps[SEQUENTIAL].resampled(STEPS),
        rasterized=True,
    )
    axes.plot(
        *place_mm.T, ".", color="white", mew=0, markersize=min(2.0, 20 / np.sqrt(len(place_mm)))
    )
    axes.set_title(f"(c) {shown['model'].iloc[0]}\n(dots: places)")
    axes.set_xlabel("x, mm")
    axes.set_ylabel("y, mm")
    extend = "max" if places["mae_N"].max() > largest else "neither"
    label = f"mean |error of force|, N; largest {places['mae_N'].max():.2f}"
    _bar(figure, mesh, axes, label, extend)


def _bar(
    figure: Figure, mappable: ScalarMappable, axes: Axes, label: str, extend: str = "neither"
) -> Colorbar:
    bar = figure.colorbar(
        mappable, ax=axes, location="bottom", aspect=35, shrink=0.8, extend=extend
    )
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)
    return bar


def write(
    models: dict[str, tuple[pd.DataFrame, str | Path]],
    dataset: Dataset,
    skin: dict,
    vector: Path,
    image: Path,
    csv: Path,
    model: str = BEST,
) -> Choice:
    """Figure 4 of one dataset and split from every model's metrics and file of predictions; skin:
    as `Skin.metadata`; model: the one to show beside the worst, as of `choose`. The CSV holds the
    two models' test samples of every seed."""
    choice = choose({model: metrics for model, (metrics, _) in models.items()}, model)
    worst, shown = (
        joined(parquet.frame(parquet.read(models[name][1])), dataset, name)
        for name in (choice.worst, choice.shown)
    )
    table = pd.concat([worst.assign(panel="a"), shown.assign(panel="b, c")], ignore_index=True)
    figure = draw(worst, shown, Skin.from_metadata(skin, "config.yaml"), choice.remarks)
    figure_files.write(figure, table, vector, image, csv)
    return choice
