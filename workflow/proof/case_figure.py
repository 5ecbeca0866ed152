"""One case as a picture: the residual, the sentence, the corrected fit, the truth."""

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
from eitskin.diagnose.report.figures import (
    draw_residual_matrices,
    draw_residual_scale,
    skin_layout_of,
)
from eitskin.diagnose.verdict.words import place_text
from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES
from eitskin.plotting import AFTER, BEFORE, CULPRIT, MARKERS, QUIET, log_limits, style
from eitskin.quantities import number, power, quantity
from proof import ledger, measures, opened

WIDTH = 92  # characters of a line of the sentence
MOST_VALUES = 4  # of a parameter that are written out


def best_case(rows: list[dict]) -> str:
    """The case to show: a single effect that was rightly named, on electrodes if there is one, the
    one whose misfit on hidden frames fell most; the first case where there is none."""

    def worth(row: dict) -> tuple:
        is_right = row["kind"] == "single" and not measures.is_broken(row)
        is_right = is_right and measures.has_all_right(row)
        at_electrodes = is_right and bool(row["said"]["effects"][0]["electrodes"])
        fall = row["hidden"]["none"] / row["hidden"]["eitskin"] if is_right else 0.0
        return is_right, at_electrodes, 0.0 if np.isnan(fall) else fall

    return max(rows, key=worth)["case"]


def errors(
    frames: pd.DataFrame, predictions: dict[str, np.ndarray], clean: np.ndarray, noise: np.ndarray
) -> pd.DataFrame:
    """Frames with before and after: root mean square over the channels of predictions (N, M) by
    these names minus the truth (N, M), in units of a reading's noise (M,)."""
    columns = {
        name: np.sqrt((((voltage - clean) / noise) ** 2).mean(axis=1))
        for name, voltage in predictions.items()
    }
    return frames[["time_s", "force_N"]].assign(**columns)


def truth_words(effect: dict) -> str:
    """A true effect in words: name, place, values; of a single value with a unit no more."""
    name, parameters = effect["name"], EFFECTS[effect["name"]].parameters
    place = place_text({"name": name, **{kind: effect.get(kind, []) for kind in SITES}})
    true = {k: v for k, v in effect.get("parameters", {}).items() if v is not None}
    words = []
    for key, values in true.items():
        unit, is_long = parameters[key].unit, np.size(values) > MOST_VALUES
        listed = np.ravel(values)[: 1 if is_long else MOST_VALUES]
        text = ", ".join(quantity(float(value), unit, 4) for value in listed)
        word = key.removesuffix(f"_{'deg' if unit == '°' else unit}")
        is_plain = len(true) == 1 and unit != "1"
        words.append(f"{'' if is_plain else f'{word} '}{text}{' …' if is_long else ''}")
    return f"{name}, {place}" + (f": {'; '.join(words)}" if words else "")


def picture(shown: Evidence, frames: pd.DataFrame, truth: dict) -> Figure:
    """Four panels over what was said and what was true: residual of the owner's simulation, the
    skin, residual of the corrected simulation, true error on hidden frames."""
    with style():
        figure = plotting.sheet(plotting.FULL_MM, 76.0)
        grid = figure.add_gridspec(2, 4, height_ratios=(1, 0.3), width_ratios=(1, 0.85, 1, 1))
        before = figure.add_subplot(grid[0, 0])
        pair = before, figure.add_subplot(grid[0, 2], sharey=before)
        texts = "as the owner simulates it", "corrected"
        for axes, image, text in zip(pair, draw_residual_matrices(pair, shown), texts, strict=True):
            axes.set_title(f"{text},\n{axes.get_title()}", color=axes.title.get_color())
            label = "mean residual, in noise units;\na dash: well below 0"
            draw_residual_scale(figure, image, [axes], label)
        _skin(figure.add_subplot(grid[0, 1]), shown)
        _hidden(figure.add_subplot(grid[0, 3]), frames)
        _sentences(figure.add_subplot(grid[1, :]), shown, truth)
    return figure


def _skin(axes: Axes, shown: Evidence) -> None:
    skin = skin_layout_of(shown)
    plotting.outline(axes, skin.rim, skin.electrodes)
    touched = shown.frames[shown.frames["touch"]][["x_mm", "y_mm"]].drop_duplicates()
    axes.plot(touched["x_mm"], touched["y_mm"], ".", color=QUIET, markersize=3)
    named = {site for effect in shown.diagnosis["effects"] for site in effect["electrodes"]}
    for site in sorted(named):
        place = skin.electrodes[site]
        axes.plot(place.real, place.imag, "s", color=CULPRIT, markersize=5)
        label = place + 0.2 * skin.half_extent_mm * skin.outward[site]
        axes.text(label.real, label.imag, str(site), color=CULPRIT, ha="center", va="center")
    axes.set_axis_off()
    reach = 1.3 * skin.half_extent_mm * np.array([-1.0, 1.0])
    axes.set(xlim=skin.centre.real + reach, ylim=skin.centre.imag + reach)
    axes.set_title("electrodes named;\ndots: touches" if named else "dots: touches", color=QUIET)


def _sentences(axes: Axes, shown: Evidence, truth: dict) -> None:
    axes.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(0, 1))
    entries = shown.diagnosis["effects"]
    sentence = " ".join(entry["sentence"] for entry in entries)
    sentence = sentence or shown.diagnosis["other"]["sentence"] or "Nothing is missing."
    concealed = "; ".join(map(truth_words, truth["effects"])) or "nothing"
    if truth["outside"]:
        concealed = truth["outside"]["law"]
    for y, head, text, colour in (
        (1.0, "said of the recording", sentence, AFTER),
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
    """The picture of the `best_case` of an opened block, as SVG and PNG, its hidden frames as
    CSV."""
    case = best_case(opened.rows(block))
    verdict, files = block / "verdicts" / case, ledger.files_of(block, case)
    truth, arrays = opened.read(block / "opened", case)
    clean = arrays["query_clean_V"]
    after, _ = opened.predicted(verdict / "predicted.parquet", clean.shape)
    with np.load(block / "baselines" / f"{case}.npz", allow_pickle=False) as file:
        predictions = {"before": file["none"], "after": after}
    query = parquet.frame(parquet.read(files["query"], ["time_s", "force_N"]))
    frames = errors(query, predictions, clean, arrays["noise_V"])
    shown = evidence.read(verdict, files["recording"], schema)
    figure_files.write(picture(shown, frames, truth), frames, *out)
