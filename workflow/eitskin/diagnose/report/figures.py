"""The figures of a diagnosis: 85 mm wide, one style, before in one colour and after in another."""

import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from eitskin.diagnose.report.evidence import Evidence
from eitskin.diagnose.search.gates import DISTINCT, NOTHING_UNNAMED
from eitskin.diagnose.verdict.words import is_certain, place_text, sites_text
from eitskin.effects import EFFECTS
from eitskin.physics.geometry import even_angles
from eitskin.plotting import (
    AFTER,
    BEFORE,
    CENTRED,
    CULPRIT,
    DIVERGING,
    MARKERS,
    PLAIN,
    QUIET,
    SEQUENTIAL,
    STEPS,
    column,
    draw_matrix,
    log_limits,
    log_ticks,
    matrix,
    sheet,
    style,
)
from eitskin.quantities import MINUS, number, power

MOST_VECTORS = 3000  # dots of a figure; more are drawn as an image
MOST_CHORDS = 8  # drives or measuring pairs of one effect that are drawn
TAG_STEP = 0.19  # between numbers at one electrode, in radii of the skin
MOST_TAGS = 3  # at one electrode or pair; of more the last tells how many more
LABEL = 54  # characters of a line under the ring
MOST_RIVALS = 5  # of one effect
BINS = 10
FALLEN = 0.05  # of the largest change: a fall that is told from no change
APART = 10  # times: matrices whose limits differ by more have a scale of colours each
LEAST_GAP, LINEAR_GAP = 0.1, 30.0  # of the axis of gaps; above the latter it is logarithmic
PALEST = 1 / 3  # of the colours' limit: residuals within it may be noise
TITLES = (("before", BEFORE), ("after", AFTER))
LABEL_ROOM = 1.8  # times: left free at both ends of the axis of what was held out
SHOWN = 0.97  # of the channels lie within the colours of the residual matrix


def draw(evidence: Evidence) -> dict[str, Figure | str]:
    """Every figure by name, or the sentence that says why there is none.

    To be saved within `style`, as `svg` and `png` do.
    """
    with style():
        return {name: function(evidence) for name, function in FIGURES.items()}


def electrodes(evidence: Evidence) -> Figure:
    """The ring of electrodes, seen from the touched side; culprits marked, touches as dots."""
    angle, radius = layout(evidence)
    effects, labels = _numbered(evidence.diagnosis)
    marked = {
        k: effect["electrodes"] if 2 * len(effect["electrodes"]) <= len(angle) else []
        for k, effect in effects
    }
    named = [e for chosen in marked.values() for e in chosen]
    most = min(max(map(named.count, named), default=0), MOST_TAGS)
    outer = 1.2 + TAG_STEP * most
    text_mm = 4.0 * (1 + len(labels))
    figure = column(76 + text_mm)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, text_mm / (76 + text_mm), 1, 76 / (76 + text_mm)))
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=(-outer, outer), ylim=(-outer, outer))
    axes.add_patch(Circle((0, 0), 1, facecolor="#f6f6f6", edgecolor="#404040", linewidth=0.8))
    for k, effect in effects:
        if "name" in effect and EFFECTS[effect["name"]].disc:
            _draw_patch(axes, effect["parameters"], radius, k)
    frames = evidence.frames[evidence.frames["touch"]]
    places = frames[["x_mm", "y_mm"]].drop_duplicates() / radius
    many = len(places) > MOST_VECTORS
    axes.scatter(places["x_mm"], places["y_mm"], s=5, color=QUIET, linewidths=0, rasterized=many)
    rim = np.exp(1j * np.radians(angle))
    for electrode, z in enumerate(rim):
        culprit = electrode in named
        colour = CULPRIT if culprit else "#202020"
        arc = z * np.exp(1j * np.linspace(-1, 1, 9) * min(0.07, 1.2 / len(rim)))
        axes.plot(arc.real, arc.imag, color=colour, linewidth=5 if culprit else 3.2)
        weight = "bold" if culprit else "normal"
        at = 1.13 * z
        axes.text(at.real, at.imag, str(electrode), color=colour, weight=weight, **CENTRED)
    for electrode in set(named):
        at = [k for k, chosen in marked.items() if electrode in chosen]
        _tags(axes, (1.15 + TAG_STEP) * rim[electrode], TAG_STEP * rim[electrode], at)
    _draw_pairs(axes, effects, rim, evidence.channels)
    notes = ["seen from the touched side", "dots: touches" if len(places) else "no touches"]
    if evidence.recording.skin.electrode_deg is None:
        notes.append("angles unknown, drawn evenly")
    line = 4.0 / (76 + text_mm)
    figure.text(0.5, line * (len(labels) + 0.5), "; ".join(notes), color=QUIET, **CENTRED)
    for k, label in enumerate(reversed(labels)):
        figure.text(0.03, line * (k + 0.5), label, color=CULPRIT, va="center")
    return figure


def _numbered(diagnosis: dict) -> tuple[list[tuple[int | str, dict]], list[str]]:
    """What is named, and what has no name where that is likely, by its number; lines that tell it
    in words."""
    effects: list[tuple[int | str, dict]] = list(enumerate(diagnosis["effects"], start=1))
    other = diagnosis["other"]
    told = [
        f"{k}  {'' if is_certain(effect) else 'perhaps '}{effect['name']}: {place_text(effect)}"
        for k, effect in effects
    ]
    if not NOTHING_UNNAMED.admits(other["probability"]):
        effects.append(("?", other | {"channels": []}))
        told.append(f"?  no name: {sites_text(other) or 'no single site'}")
    fold = textwrap.TextWrapper(LABEL, subsequent_indent="     ", break_on_hyphens=False)
    return effects, [line for text in told for line in fold.wrap(text)]


def layout(evidence: Evidence) -> tuple[np.ndarray, float]:
    """Angles (n,) deg of the electrodes, evenly where unknown, and the skin's radius, mm; where
    that is unknown, one that holds every touch."""
    skin, calibrated = evidence.recording.skin, evidence.diagnosis["calibration"]
    known = skin.electrode_deg
    angle = even_angles(evidence.recording.n_electrodes) if known is None else known
    radius = skin.radius_mm or calibrated.get("radius_mm", {}).get("value")
    if radius is None:
        reach = np.hypot(evidence.frames["x_mm"], evidence.frames["y_mm"]).max()
        radius = 1.2 * reach if reach > 0 else 1.0
    return np.asarray(angle, float), float(radius)


def _draw_patch(axes: Axes, parameters: dict, radius: float, k: int | str) -> None:
    x, y, size = (parameters[key]["value"] / radius for key in ("x_mm", "y_mm", "radius_mm"))
    axes.add_patch(Circle((x, y), size, facecolor=CULPRIT, alpha=0.25, linewidth=0))
    _tag(axes, complex(x, y), k)


def _draw_pairs(axes: Axes, effects: list, rim: np.ndarray, channels: np.ndarray) -> None:
    """The pairs that an effect is on as chords with its number: drives as arrows, measuring pairs
    dashed; none for an effect on many."""
    taken: dict[tuple[int, int], list[int | str]] = {}
    for k, effect in effects:
        pairs = []
        for kind, ends in (("drives", (0, 1)), ("measures", (2, 3))):
            chosen = np.isin(channels[:, ends[0]], effect[kind])
            if len(effect[kind]) <= MOST_CHORDS:
                pairs += [(kind, *p) for p in np.unique(channels[chosen][:, ends], axis=0)]
        if len(effect["channels"]) <= MOST_CHORDS // 2:
            for source, sink, plus, minus in channels[effect["channels"]]:
                pairs += [("drives", source, sink), ("measures", plus, minus)]
        for kind, first, last in pairs:
            a, b = 0.93 * rim[first], 0.93 * rim[last]
            drive = kind == "drives"
            line = {"color": CULPRIT, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
            line |= {"arrowstyle": "-|>" if drive else "-", "linestyle": "-" if drive else ":"}
            axes.annotate("", (b.real, b.imag), (a.real, a.imag), arrowprops=line)
            taken.setdefault((first, last), []).append(k)
    for (first, last), numbers in taken.items():
        a, b = 0.93 * rim[first], 0.93 * rim[last]
        middle = 0.5 * (a + b) if abs(a + b) > 0.5 else 0.3 * a
        _tags(axes, 0.93 * middle, -TAG_STEP * middle, numbers)


def _tags(axes: Axes, at: complex, step: complex, numbers: Sequence[int | str]) -> None:
    """Numbers one beside another, from a place on; of more than MOST_TAGS how many more."""
    if len(numbers) > MOST_TAGS:
        numbers = [*numbers[: MOST_TAGS - 1], f"+{len(numbers) - MOST_TAGS + 1}"]
    for level, k in enumerate(numbers):
        _tag(axes, at + level * step, k)


def _tag(axes: Axes, at: complex, text: object) -> None:
    box = {"boxstyle": "circle,pad=0.2", "facecolor": CULPRIT, "edgecolor": "white"}
    white: dict[str, Any] = {"color": "white", "weight": "bold", "fontsize": 6}
    axes.text(at.real, at.imag, str(text), bbox=box | {"linewidth": 0.5}, **white, **CENTRED)


def residual_matrix(evidence: Evidence) -> Figure:
    """Mean residual of every channel over the frames, in noise units, before and after."""
    figure = column(58)
    row = figure.subplots(1, 2, sharey=True)
    images = draw_matrices(row, evidence)
    if one_scale(images):
        label = f"recording {MINUS} simulation, mean over the frames,\n"
        matrix_bar(figure, images[0], row, f"{label}in units of the noise of a reading")
    else:
        for axes, image in zip(row, images, strict=True):
            matrix_bar(figure, image, [axes], "mean residual, in noise units;\na scale of its own")
    return figure


def draw_matrices(row: Sequence[Axes], evidence: Evidence) -> list[QuadMesh]:
    """`residual_matrix` on two axes that share y, before and after, in one scale of colours unless
    they are far APART; a dash where the recording is well below the simulation."""
    panels = [matrix(evidence.channels, _mean(r)) for r in (evidence.before, evidence.after)]
    quiet = 10 / np.sqrt(len(evidence.frames))  # noise alone stays in the palest third
    limits = [
        _rounded_up(max(quiet, float(np.nanquantile(np.abs(panel), SHOWN)))) for panel in panels
    ]
    if max(limits) <= APART * min(limits):
        limits = [max(limits)] * 2
    images = []
    for axes, panel, limit, (title, colour) in zip(row, panels, limits, TITLES, strict=True):
        norm = Normalize(-limit, limit)
        images.append(draw_matrix(axes, evidence.channels, panel, norm, DIVERGING))
        _dash_falls(axes, panel, limit, PALEST, 18.0)
        residual = evidence.before if title == "before" else evidence.after
        rms = number(float(np.sqrt(np.nanmean(residual**2))))
        axes.set_title(f"{title}: rms {rms}", color=colour)
    row[0].set_ylabel("drive, source electrode")
    row[0].invert_yaxis()
    return images


def _rounded_up(value: float) -> float:
    """To one digit, so that a half of it is written with two."""
    ten = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / ten) * ten)


def one_scale(images: Sequence[QuadMesh]) -> bool:
    """Whether what `draw_matrices` drew shares its colours."""
    return len({image.get_clim() for image in images}) == 1


def matrix_bar(figure: Figure, image: QuadMesh, beside: Sequence[Axes], label: str) -> None:
    """The colours' scale of `draw_matrices`, under some axes."""
    limit = image.get_clim()[1]
    assert limit is not None
    several = len(beside) > 1
    place: dict[str, Any] = {"location": "bottom", "aspect": 40 if several else 20, "shrink": 0.8}
    bar = figure.colorbar(image, ax=beside, pad=0.03, extend="both", **place)
    ticks = [share * limit for share in ((-1, -0.5, 0.0, 0.5, 1) if several else (-1, 0.0, 1))]
    bar.set_ticks(ticks, labels=[number(tick, 2) for tick in ticks])
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)


def changes(evidence: Evidence) -> list[Figure | None]:
    """What each effect changes in the frame in which it changes most, to stand beside it; None
    where it changes nothing that is known."""
    with style():
        return [
            _change(evidence.channels, change) if np.nan_to_num(change).any() else None
            for change in evidence.changes
        ]


def _change(channels: np.ndarray, change: np.ndarray) -> Figure:
    figure = sheet(50, 58)
    axes = figure.add_subplot()
    draw_change(figure, axes, channels, change, "in units of the noise of a reading")
    axes.set_ylabel("drive, source electrode")
    return figure


def draw_change(
    figure: Figure, axes: Axes, channels: np.ndarray, value: np.ndarray, label: str
) -> None:
    """A change (M,) of every channel (M, 4), symmetric colours, dashes where it falls, and its
    scale below."""
    cells = matrix(channels, value)
    limit = float(np.nanmax(np.abs(cells)))
    image = draw_matrix(axes, channels, cells, Normalize(-limit, limit), DIVERGING)
    axes.invert_yaxis()
    _dash_falls(axes, cells, limit, FALLEN, 50.0)
    scale(figure, axes, image, label)


def _dash_falls(axes: Axes, cells: np.ndarray, limit: float, least: float, size: float) -> None:
    """A dash in each cell that is below 0 by more than a share `least` of the colours' limit, so
    that print and eyes without colours have its sign; size: of all dashes of a row, points."""
    row, place = np.nonzero(cells < -least * limit)
    colours = np.where(cells[row, place] < -limit / 2, "white", "#404040")
    axes.scatter(place, row, marker="_", c=colours, s=size / max(cells.shape), linewidths=0.5)


def scale(figure: Figure, axes: Axes, image: QuadMesh, label: str) -> None:
    """The colours' scale under one matrix, its ends and its middle told."""
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=22, shrink=0.9, pad=0.03)
    ticks = [float(one) for one in bar.norm.inverse(np.array([0.0, 0.5, 1.0]))]
    bar.set_ticks(ticks, labels=[number(one, 2) for one in ticks])
    bar.ax.minorticks_off()
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)


def _mean(residual: np.ndarray) -> np.ndarray:
    """(M,): mean over the frames; NaN for a channel that was always lost."""
    count = np.isfinite(residual).sum(axis=0)
    return np.nansum(residual, axis=0) / np.where(count, count, np.nan)


def misfit_force(evidence: Evidence) -> Figure | str:
    """Chi2 per reading of each frame against the force."""
    force = evidence.frames["force_N"].to_numpy(float)
    if not evidence.frames["touch"].any():
        return "No frame was touched: there is no misfit against force."
    if np.isnan(force[evidence.frames["touch"]]).all():
        return "Nobody measured the force: there is no misfit against it."
    return _misfit(evidence, force, "force, N (0: untouched)")


def misfit_time(evidence: Evidence) -> Figure | str:
    """Chi2 per reading of each frame against time."""
    if len(evidence.frames) == 1:
        return "One frame was diagnosed: there is no misfit against time."
    if evidence.recording.metadata["clock"] == "index":
        figure = _misfit(evidence, np.arange(len(evidence.frames), dtype=float), "frame")
        figure.axes[0].xaxis.set_major_locator(MaxNLocator("auto", integer=True))
        return figure
    return _misfit(evidence, evidence.frames["time_s"].to_numpy(float), "time, s")


def misfit_place(evidence: Evidence) -> Figure | str:
    """Chi2 per reading of the touches at each place, a map over the skin."""
    known = evidence.frames[["x_mm", "y_mm"]].notna().all(axis=1)
    chi2 = _chi2(evidence)
    touch = (evidence.frames["touch"] & known).to_numpy() & np.isfinite(chi2).all(axis=0)
    if not touch.any():
        return "No touch of known place, force and probe: there is no map of the misfit."
    angle, radius = layout(evidence)
    table = evidence.frames.loc[touch, ["x_mm", "y_mm"]]
    table = table.assign(**{t: c[touch] for (t, _), c in zip(TITLES, chi2, strict=True)})
    places = table.groupby(["x_mm", "y_mm"], as_index=False).mean()
    shown = places[["before", "after"]].to_numpy()
    low, high = min(0.5, 0.9 * max(shown.min(), 1e-3)), max(2.0, 1.1 * shown.max())
    norm = LogNorm(low, high)
    figure = column(56)
    figure.set_layout_engine("compressed", w_pad=0.02, h_pad=0.02)  # of maps of equal scales
    row = figure.subplots(1, 2, sharey=True)
    rim = radius * np.exp(1j * np.radians(angle))
    circle = radius * np.exp(2j * np.pi * np.linspace(0, 1, 181))
    size = float(np.clip(2500 / len(places), 3, 28))
    for axes, (title, colour) in zip(row, TITLES, strict=True):
        axes.plot(circle.real, circle.imag, color="#404040", linewidth=0.6)
        axes.plot(rim.real, rim.imag, "s", color="#202020", markersize=2)
        image = axes.scatter(
            places["x_mm"],
            places["y_mm"],
            s=size,
            c=places[title],
            norm=norm,
            cmap=matplotlib.colormaps[SEQUENTIAL].resampled(STEPS),
            linewidths=0.2,
            edgecolors="#404040",
            rasterized=len(places) > MOST_VECTORS,
        )
        axes.set_aspect("equal")
        axes.set_title(title, color=colour)
        axes.set_xlabel("x, mm")
    row[0].set_ylabel("y, mm")
    bar = figure.colorbar(image, ax=row, location="bottom", aspect=40, shrink=0.8, pad=0.03)
    log_ticks(bar.ax.xaxis, low, high, power)
    bar.set_label("χ² per reading, mean over a place's touches; noise alone: 1")
    bar.outline.set_linewidth(0.4)
    return figure


def _chi2(evidence: Evidence) -> list[np.ndarray]:
    """Before and after (N,): mean square of each frame's residuals in noise units, NaN where all
    are lost."""
    found = []
    for residual in (evidence.before, evidence.after):
        count = np.isfinite(residual).sum(axis=1)
        found.append(np.nansum(residual**2, axis=1) / np.where(count, count, np.nan))
    return found


def _misfit(evidence: Evidence, x: np.ndarray, label: str) -> Figure:
    figure = column(48)
    axes = figure.add_subplot()
    values = _chi2(evidence)
    for y, (title, colour), width, marker in zip(values, TITLES, (2.2, 1.2), MARKERS, strict=True):
        many = len(x) > MOST_VECTORS
        axes.plot(x, y, ".", color=colour, markersize=3.4, alpha=0.4, mew=0, rasterized=many)
        centre, mean = _binned(x, y)
        line: dict[str, Any] = {"color": colour, "linewidth": width, "markersize": 3}
        axes.plot(centre, mean, f"-{marker}", label=title, **line)
    axes.axhline(1, color="#202020", linewidth=0.7, linestyle=(0, (4, 2)), label="noise alone")
    axes.set_xlabel(label)
    axes.set_ylabel("χ² per reading")
    axes.set_yscale("log")
    log_limits(axes.yaxis, np.concatenate(values), power)
    figure.legend(loc="outside upper center", ncols=3, borderpad=0.1, columnspacing=1.5)
    return figure


def _binned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean x and y of as many frames each; of each x by itself where there are few different."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    values, label = np.unique(x, return_inverse=True)
    if len(values) > BINS:
        label = np.empty(len(x), int)
        label[np.argsort(x, kind="stable")] = np.arange(len(x)) * BINS // len(x)
    count = np.bincount(label)
    return np.bincount(label, x) / count, np.bincount(label, y) / count


def learned(evidence: Evidence) -> bool:
    """Whether errors of the rig are part of the noise."""
    return bool(evidence.diagnosis.get("noise", {}).get("components"))


def held_out(evidence: Evidence) -> Figure:
    """Chi2 per degree of freedom of what was held out, before and after; noise gives 1. Hollow:
    against white noise alone, where errors of the rig are told."""
    fit = evidence.diagnosis["fit"]["held_out"]
    values = [fit[f"chi2_per_dof_{title}"] for title, _ in TITLES]
    keys = [f"white_chi2_per_dof_{title}" for title, _ in TITLES]
    white = [fit[key] for key in keys] if learned(evidence) else []
    figure = column(32 if white else 26)
    axes = figure.add_subplot()
    axes.axvline(1, color="#202020", linewidth=0.7, linestyle=(0, (4, 2)))
    for y, value, (_, colour), marker in zip((1, 0), white, TITLES, MARKERS, strict=False):
        axes.plot(value, y, marker, color=colour, markersize=6, markerfacecolor="white")
    for y, value, (_, colour), marker in zip((1, 0), values, TITLES, MARKERS, strict=True):
        axes.plot([1, value], [y, y], color=colour, linewidth=0.8, alpha=0.6, zorder=1)
        axes.plot(value, y, marker, color=colour, markersize=6)
        above: dict[str, Any] = {
            "xytext": (0, 4),
            "textcoords": "offset points",
            "ha": "center",
            "va": "bottom",
        }
        text = number(value)
        axes.annotate(text, (value, y), color=colour, weight="bold", bbox=PLAIN, **above)
    axes.set_xscale("log")
    reach = np.array([*values, *white, min(values) / LABEL_ROOM])
    log_limits(axes.xaxis, reach, power, room=LABEL_ROOM)
    if white:
        dot: dict[str, Any] = {"marker": "o", "color": "#202020", "linestyle": "", "markersize": 5}
        hollow: dict[str, Any] = {"markerfacecolor": "white", "label": "white noise alone"}
        dots = [Line2D([], [], **dot, label="noise and rig"), Line2D([], [], **dot, **hollow)]
        figure.legend(handles=dots, loc="outside upper center", ncols=2, borderpad=0.1)
    axes.set(ylim=(-0.5, 1.8), yticks=[1, 0], yticklabels=[title for title, _ in TITLES])
    expected = "noise and rig" if white else "noise"
    axes.set_xlabel(f"held-out χ² per degree of freedom; {expected} alone: 1")
    for tick, (_, colour) in zip(axes.get_yticklabels(), TITLES, strict=True):
        tick.set_color(colour)
    return figure


def rivals(evidence: Evidence) -> Figure | str:
    """Chi2 of frames held out in turn, of all that is named, with an effect taken out again, and
    with another name in its place."""
    table = evidence.tables["rivals"]
    if table.empty:
        return "No effect was named: there is none to take out or to replace."
    of_none = table["effect"] == ""
    rows = [("all that is named", v, None, AFTER) for v in table["chi2_per_dof"][of_none]]
    for effect, group in table[~of_none].groupby("effect", sort=False):
        out = group["instead"] == "nothing"
        for _, row in group[out].iterrows():
            rows.append((f"without {effect}", row["chi2_per_dof"], row["elpd_difference"], BEFORE))
        best = group[~out].sort_values("elpd_difference", ascending=False, kind="stable")
        for _, row in best.head(MOST_RIVALS).iterrows():
            name = f"{row['instead']} instead"
            rows.append((name, row["chi2_per_dof"], row["elpd_difference"], QUIET))
    figure = column(12 + 6.5 * len(rows))
    axes = figure.add_subplot()
    axes.spines["left"].set_visible(False)
    axes.axvline(1, color="#202020", linewidth=0.7, linestyle=(0, (4, 2)))
    for y, (name, value, elpd, colour) in enumerate(rows):
        axes.plot([rows[0][1], value], [y, y], color=colour, linewidth=0.8, alpha=0.6)
        axes.plot(value, y, "o", color=colour, markersize=4)
        text = number(value) if elpd is None else f"{number(value)} ({number(elpd)} nats)"
        above: dict[str, Any] = {
            "textcoords": ("axes fraction", "data"),
            "va": "center",
            "color": colour,
        }
        axes.annotate(name, (value, y), xytext=(0, y - 0.45), ha="left", bbox=PLAIN, **above)
        axes.annotate(text, (value, y), xytext=(1, y - 0.45), ha="right", bbox=PLAIN, **above)
    axes.set_xscale("log")
    log_limits(axes.xaxis, np.array([value for _, value, *_ in rows]), power)
    axes.set(ylim=(len(rows) - 0.6, -0.8), yticks=[])
    axes.set_xlabel("χ² per degree of freedom, held out in turn")
    return figure


def next_experiment(evidence: Evidence) -> Figure | str:
    """The gap between names now, and after the experiment proposed."""
    pairs = evidence.experiment["pairs"]
    if not pairs:
        return "No pair of names is left to be told apart."
    figure = column(20 + 8 * len(pairs))
    axes = figure.add_subplot()
    gaps = np.array([[pair["gap_now"], pair["gap_then"]] for pair in pairs])
    if 1.25 * gaps.max() > LINEAR_GAP:
        gaps = np.maximum(gaps, LEAST_GAP)
        axes.set_xscale("log")
        log_limits(axes.xaxis, gaps, power, room=1.25)
    else:
        axes.set_xlim(0, 1.25 * max(DISTINCT.threshold, gaps.max()))
    axes.axvspan(axes.get_xlim()[0], DISTINCT.threshold, color="#e4e4e4", linewidth=0)
    for y, (pair, ends) in enumerate(zip(pairs, gaps, strict=True)):
        arrow = {"arrowstyle": "-|>", "color": "#202020", "linewidth": 1, "shrinkA": 3}
        axes.annotate("", (ends[1], y), (ends[0], y), arrowprops=arrow | {"shrinkB": 3})
        axes.plot(ends[0], y, "o", color="#202020", markersize=5, markerfacecolor="white")
        axes.plot(ends[1], y, "o", color="#202020", markersize=5)
        for word, at, height in zip(("now", "then"), ends, (5, -11), strict=True):
            across = axes.transLimits.transform(axes.transScale.transform((at, y)))[0]
            side = "left" if across < 0.1 else "right" if across > 0.9 else "center"
            text = f"{word} {number(pair[f'gap_{word}'], 2)}"
            place: dict[str, Any] = {"xytext": (0, height), "textcoords": "offset points"}
            axes.annotate(text, (at, y), fontsize=6.5, ha=side, **place)
    axes.set(ylim=(len(pairs) - 0.3, -0.7), yticks=range(len(pairs)))
    axes.set_yticklabels([f"{pair['a']}\nor {pair['b']}" for pair in pairs])
    axes.set_xlabel("gap, in noise units")
    return figure


FIGURES = {
    "electrodes": electrodes,
    "residual_matrix": residual_matrix,
    "misfit_force": misfit_force,
    "misfit_time": misfit_time,
    "misfit_place": misfit_place,
    "held_out": held_out,
    "rivals": rivals,
    "next_experiment": next_experiment,
}
