"""One concealed case as a picture: the residual, the sentence, the corrected fit, the truth."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eitskin import figure_files, plotting
from eitskin.data import parquet
from eitskin.diagnose.report import evidence
from eitskin.diagnose.report.evidence import Evidence
from eitskin.diagnose.report.figures import draw_matrices, layout, matrix_bar
from eitskin.diagnose.verdict.words import where
from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES
from eitskin.plotting import AFTER, BEFORE, CULPRIT, MARKERS, QUIET, log_limits, style
from eitskin.quantities import number, power, quantity
from proof import judge, opened, scoring

WIDTH = 92  # characters of a line of the sentence


def shown(rows: list[dict]) -> str:
    """The case to show: a single effect that was rightly named, on electrodes if there is one, the
    one whose misfit on hidden frames fell most; the first case where there is none."""

    def worth(row: dict) -> tuple:
        right = row["kind"] == "single" and "failed" not in row
        right = right and len(row["said"]["effects"]) == 1 == sum(map(bool, judge.matched(row)))
        at = right and bool(row["said"]["effects"][0]["electrodes"])
        fell = row["hidden"]["none"] / row["hidden"]["eitskin"] if right else 0.0
        return right, at, 0.0 if np.isnan(fell) else fell

    return max(rows, key=worth)["case"]


def hidden(block: Path, case: str) -> pd.DataFrame:
    """time_s, force_N, before and after of every hidden frame: root mean square over the channels
    of prediction minus truth, in units of a reading's noise."""
    _, arrays = opened.read(block / "opened", case)
    clean, noise = arrays["query_clean_V"], arrays["noise_V"]
    query = parquet.read(block / "queries" / f"{case}.parquet", ["time_s", "force_N"])
    table = parquet.frame(query)
    after, _ = scoring.predicted(block / "verdicts" / case / "predicted.parquet", clean.shape)
    with np.load(block / "baselines" / f"{case}.npz", allow_pickle=False) as file:
        before = file["none"]
    return table.assign(**errors(before, after, clean, noise))


def errors(
    before: np.ndarray, after: np.ndarray, clean: np.ndarray, noise: np.ndarray
) -> dict[str, np.ndarray]:
    """(N,) each: root mean square over the channels of two predictions (N, M) minus the truth, in
    units of a reading's noise (M,)."""
    return {
        key: np.sqrt((((voltage - clean) / noise) ** 2).mean(axis=1))
        for key, voltage in (("before", before), ("after", after))
    }


def truth_of(item: dict) -> str:
    """A true effect in words: name, place, values; of a single value with a unit no more."""
    effect = EFFECTS[item["name"]]
    at = where({"name": item["name"], **{kind: item.get(kind, []) for kind in SITES}})
    known = {k: v for k, v in item.get("parameters", {}).items() if v is not None}
    values = []
    for key, given in known.items():
        several = np.size(given) > 4
        unit = effect.parameters[key].unit
        text = ", ".join(
            quantity(float(v), unit, 4) for v in np.ravel(given)[: 1 if several else 4]
        )
        word = key.removesuffix(f"_{'deg' if unit == '°' else unit}")
        alone = len(known) == 1 and unit != "1"
        values.append(f"{'' if alone else f'{word} '}{text}{' …' if several else ''}")
    return f"{item['name']}, {at}" + (f": {'; '.join(values)}" if values else "")


def draw(shown: Evidence, frames: pd.DataFrame, truth: dict) -> Figure:
    """Four panels over what was said and what was true: residual of the owner's simulation, the
    skin, residual of the corrected simulation, true error on hidden frames."""
    with style():
        figure = plotting.sheet(plotting.FULL_MM, 76.0)
        grid = figure.add_gridspec(2, 4, height_ratios=(1, 0.3), width_ratios=(1, 0.85, 1, 1))
        first = figure.add_subplot(grid[0, 0])
        third = figure.add_subplot(grid[0, 2], sharey=first)
        pair = first, third
        texts = "as the owner simulates it", "corrected"
        for axes, image, text in zip(pair, draw_matrices(pair, shown), texts, strict=True):
            axes.set_title(f"{text},\n{axes.get_title()}", color=axes.title.get_color())
            label = "mean residual, in noise units;\na dash: well below 0"
            matrix_bar(figure, image, [axes], label)
        _skin(figure.add_subplot(grid[0, 1]), shown)
        _hidden(figure.add_subplot(grid[0, 3]), frames)
        _said(figure.add_subplot(grid[1, :]), shown, truth)
    return figure


def _skin(axes: Axes, shown: Evidence) -> None:
    angle, radius = layout(shown)
    plotting.disc(axes, radius, angle)
    touched = shown.frames[shown.frames["touch"]][["x_mm", "y_mm"]].drop_duplicates()
    axes.plot(touched["x_mm"], touched["y_mm"], ".", color=QUIET, markersize=3)
    rim = radius * np.exp(1j * np.radians(angle))
    named = {site for effect in shown.diagnosis["effects"] for site in effect["electrodes"]}
    for site in sorted(named):
        axes.plot(rim[site].real, rim[site].imag, "s", color=CULPRIT, markersize=5)
        at = 1.2 * rim[site]
        axes.text(at.real, at.imag, str(site), color=CULPRIT, ha="center", va="center")
    axes.set_axis_off()
    axes.set(xlim=(-1.3 * radius, 1.3 * radius), ylim=(-1.3 * radius, 1.3 * radius))
    axes.set_title("electrodes named;\ndots: touches" if named else "dots: touches", color=QUIET)


def _said(axes: Axes, shown: Evidence, truth: dict) -> None:
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0, 1))
    effects = shown.diagnosis["effects"]
    said = " ".join(effect["sentence"] for effect in effects)
    said = said or shown.diagnosis["other"]["sentence"] or "Nothing is missing."
    concealed = "; ".join(truth_of(item) for item in truth["effects"]) or "nothing"
    if truth["outside"]:
        concealed = truth["outside"]["law"]
    for y, head, text, colour in (
        (1.0, "said of the recording", said, AFTER),
        (0.36, "concealed in it", concealed, CULPRIT),
    ):
        lines = "\n".join(textwrap.wrap(text, WIDTH, max_lines=2))
        axes.text(0.24, y, head, color=QUIET, ha="right", va="top")
        axes.text(0.26, y, lines, color=colour, weight="bold", va="top")


def _hidden(axes: Axes, frames: pd.DataFrame) -> None:
    for key, colour, marker in zip(("before", "after"), (BEFORE, AFTER), MARKERS, strict=True):
        middle = number(float(np.sqrt((frames[key] ** 2).mean())))
        dot: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "linestyle": "",
            "markersize": 2.5,
        }
        axes.plot(frames["force_N"], frames[key], **dot, alpha=0.7, mew=0)
        axes.plot([], [], **dot, label=f"true error {key}: rms {middle}")
    axes.axhline(
        1.0, color="#202020", linewidth=0.7, linestyle=(0, (4, 2)), label="noise of a reading"
    )
    axes.set_yscale("log")
    log_limits(axes.yaxis, frames[["before", "after"]].to_numpy(), power)
    axes.set_xlabel("force, N (0: untouched)")
    axes.set_ylabel("true error, in noise units")
    axes.set_title("hidden frames: other\nplaces, forces and probe")
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.4, -0.4)}
    legend = axes.legend(borderpad=0.1, handletextpad=0.2, borderaxespad=0.0, **below)
    legend.set_in_layout(False)  # it stands where the other panels have their scales


def write(block: Path, schema: Path, out: tuple[Path, Path, Path]) -> None:
    """The picture of the case that is `shown` of an opened block, as SVG and PNG, its hidden frames
    as CSV."""
    case = shown(scoring.rows(block))
    folder = block / "verdicts" / case
    found = evidence.read(folder, block / "recordings" / f"{case}.parquet", schema)
    frames = hidden(block, case)
    truth, _ = opened.read(block / "opened", case)
    figure_files.write(draw(found, frames, truth), frames, *out)
