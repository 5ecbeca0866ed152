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

from eitskin.diagnose.report.answer import own_sizes_misfit
from eitskin.diagnose.report.evidence import Evidence
from eitskin.diagnose.search.gates import DISTINCT, NOTHING_UNNAMED
from eitskin.diagnose.verdict.words import (
    UNITS,
    is_certain,
    last_scores,
    place_text,
    sites_text,
)
from eitskin.effects import EFFECTS
from eitskin.physics.outline import is_plain_disc
from eitskin.plotting import (
    AFTER,
    BEFORE,
    CENTRED,
    CULPRIT,
    DIVERGING,
    ELECTRODE,
    MARKERS,
    PLAIN,
    QUIET,
    RIM,
    SEQUENTIAL,
    STEPS,
    column,
    draw_matrix,
    log_limits,
    log_ticks,
    matrix,
    outline,
    sheet,
    style,
)
from eitskin.quantities import MINUS, number, power, prefixed, quantity
from eitskin.skin_layout import SkinLayout, layout

TITLES = (("before", BEFORE), ("after", AFTER))  # of pairs of panels, and their colours
DASHED: tuple[float, tuple[int, int]] = (0, (4, 2))  # the line of what noise alone gives
MOST_VECTOR_DOTS = 3000  # of a figure: with more elements in its SVG a browser is slow
RING_MM = 76.0  # height of the ring with its numbers, in a column of 85 mm
LINE_MM = 4.0  # of text under the ring, at 7 points
LINE_CHARACTERS = 54  # that fit in a line under the ring, at 7 points
NUMBER_GAP = 0.13  # of an electrode's number from the rim, in half extents of the skin
TAG_STEP = 0.19  # between numbered discs at one electrode, in half extents: they do not touch
MOST_TAGS = 3  # at one electrode or pair, for there is no room for more; the last counts the rest
ELECTRODE_POINTS = 2.0  # of an electrode's square in a map of the skin
CHORD_GAP = 0.07  # of a pair's ends from the rim, in half extents: clear of the electrodes
MOST_CHORDS = 8  # drives or measuring pairs of one effect: with more, chords hide one another
MOST_RIVALS = 5  # of one effect: the figure stays within half a page of paper
BINS = 10  # of frames over an axis of the misfit: a line of ten dots is read at a glance
# Share of the channels within the colours of a residual matrix: outliers do not set the limit.
COLOUR_QUANTILE = 0.97
# Ratio up to which two matrices share their colours; above, one of them has none but the palest.
LARGEST_SCALE_RATIO = 10
PALEST_SHARE = 1 / 3  # of the colours' limit: residuals within it may be noise
FALL_SHARE = 0.05  # of the largest change: smaller falls look like no change
# Areas of all dashes of a row, points²: by the widths of half a column and of a whole panel.
DASH_POINTS, CHANGE_DASH_POINTS = 18.0, 50.0
DARKENING = "YlOrBr"  # the darker the larger, without colours too; nothing of it is white
REFERENCE = "#202020"  # nearly black: what is neither before nor after
DASH = "#404040"  # dark enough for every cell that is lighter than half the limit
SMALLEST_GAP = 0.1  # on a logarithmic axis, which has no 0
LARGEST_LINEAR_GAP = 30.0  # ten times the gap of one class: beyond, a linear axis hides that class
GAP_ROOM = 1.25  # largest gap to the end of its axis: room for its number
MISFIT_LABEL_ROOM = 1.8  # value to the ends of the axis of held-out misfits: room for its number


def draw(evidence: Evidence) -> dict[str, Figure | str]:
    """Every figure by name, or the sentence that says why there is none.

    To be saved within `style`, as `svg` and `png` do.
    """
    with style():
        return {name: function(evidence) for name, function in FIGURES.items()}


def electrode_ring(evidence: Evidence) -> Figure:
    """The ring of electrodes, seen from the touched side: named sites marked, touches as dots."""
    skin = skin_layout_of(evidence)
    effects, lines = _numbered_effects(evidence.diagnosis)
    marked_electrodes = {
        label: effect["electrodes"] if 2 * len(effect["electrodes"]) <= len(skin.electrodes) else []
        for label, effect in effects
    }
    marks = [site for electrodes in marked_electrodes.values() for site in electrodes]
    tag_count = min(max(map(marks.count, marks), default=0), MOST_TAGS)
    outer = 1.2 + TAG_STEP * tag_count
    text_mm = LINE_MM * (1 + len(lines))
    height_mm = RING_MM + text_mm
    figure = column(height_mm)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, text_mm / height_mm, 1, RING_MM / height_mm))
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=(-outer, outer), ylim=(-outer, outer))
    corners = skin.scaled(skin.rim)
    axes.fill(corners.real, corners.imag, facecolor="#f6f6f6", edgecolor=RIM, linewidth=0.8)
    for label, effect in effects:
        if "name" in effect and EFFECTS[effect["name"]].disc:
            _draw_patch(axes, effect["parameters"], skin, label)
    touched_frames = evidence.frames[evidence.frames["touch"]]
    places = touched_frames[["x_mm", "y_mm"]].drop_duplicates().to_numpy()
    dot = skin.scaled(places[:, 0] + 1j * places[:, 1])
    is_image = len(places) > MOST_VECTOR_DOTS
    dots: dict[str, Any] = {"s": 5, "color": QUIET, "linewidths": 0, "rasterized": is_image}
    axes.scatter(dot.real, dot.imag, **dots)
    _draw_electrodes(axes, skin, marks)
    electrodes = skin.scaled(skin.electrodes)
    for electrode in set(marks):
        labels = [
            label for label, electrodes in marked_electrodes.items() if electrode in electrodes
        ]
        step = TAG_STEP * skin.outward[electrode]
        first_tag = electrodes[electrode] + 0.15 * skin.outward[electrode] + step
        _draw_tags(axes, first_tag, step, labels)
    chord_ends = electrodes - CHORD_GAP * skin.outward
    _draw_pairs(axes, effects, chord_ends, evidence.channels)
    notes = ["seen from the touched side", "dots: touches" if len(places) else "no touches"]
    stated = evidence.recording.skin
    if stated.electrode_deg is None and is_plain_disc(stated):
        notes.append("angles unknown, drawn evenly")
    line_height = LINE_MM / height_mm
    note_y = line_height * (len(lines) + 0.5)
    figure.text(0.5, note_y, "; ".join(notes), color=QUIET, **CENTRED)
    for k, line in enumerate(reversed(lines)):
        figure.text(0.03, line_height * (k + 0.5), line, color=CULPRIT, va="center")
    return figure


def _draw_electrodes(axes: Axes, skin: SkinLayout, marks: list[int]) -> None:
    """A line along the rim, or a dot inside, and its number for each electrode."""
    places = skin.scaled(skin.electrodes)
    half_length = min(0.07, 1.2 / len(places))
    for electrode, (place, outward) in enumerate(zip(places, skin.outward, strict=True)):
        is_marked = electrode in marks
        colour = CULPRIT if is_marked else ELECTRODE
        if electrode in skin.inside:
            size = 7 if is_marked else 5
            axes.plot(place.real, place.imag, "o", color=colour, markersize=size)
        else:
            line = place + 1j * outward * half_length * np.array([-1.0, 1.0])
            axes.plot(line.real, line.imag, color=colour, linewidth=5 if is_marked else 3.2)
        weight = "bold" if is_marked else "normal"
        label = place + NUMBER_GAP * outward
        axes.text(label.real, label.imag, str(electrode), color=colour, weight=weight, **CENTRED)


def _numbered_effects(diagnosis: dict) -> tuple[list[tuple[int | str, dict]], list[str]]:
    """The effects, and what has no name where that is likely, each with its label, a number or a
    question mark; lines of text that name them."""
    effects: list[tuple[int | str, dict]] = list(enumerate(diagnosis["effects"], start=1))
    remainder = diagnosis["other"]
    texts = [
        f"{label}  {'' if is_certain(effect) else 'perhaps '}{effect['name']}: {place_text(effect)}"
        for label, effect in effects
    ]
    if not NOTHING_UNNAMED.admits(remainder["probability"]):
        effects.append(("?", remainder | {"channels": []}))
        texts.append(f"?  no name: {sites_text(remainder) or 'no single site'}")
    wrapper = textwrap.TextWrapper(
        LINE_CHARACTERS, subsequent_indent="     ", break_on_hyphens=False
    )
    return effects, [line for text in texts for line in wrapper.wrap(text)]


def skin_layout_of(evidence: Evidence) -> SkinLayout:
    """The skin as it is drawn; a disc of unknown radius holds every touch."""
    recorded, diagnosis = evidence.recording, evidence.diagnosis
    scale_mm = diagnosis.get("scale", {}).get("radius_mm")
    radius = diagnosis["calibration"].get("radius_mm", {}).get("value", scale_mm)
    if radius is None:
        reach = np.hypot(evidence.frames["x_mm"], evidence.frames["y_mm"]).max()
        radius = 1.2 * reach if reach > 0 else 1.0
    return layout(recorded.skin, recorded.n_electrodes, float(radius))


def _draw_patch(axes: Axes, parameters: dict, skin: SkinLayout, label: int | str) -> None:
    """The disc of an effect that has one, with its label."""
    x, y, size = (parameters[key]["value"] for key in ("x_mm", "y_mm", "radius_mm"))
    place = complex(skin.scaled(np.array(complex(x, y))))
    disc = {"facecolor": CULPRIT, "alpha": 0.25, "linewidth": 0}
    axes.add_patch(Circle((place.real, place.imag), size / skin.half_extent_mm, **disc))
    _draw_tag(axes, place, label)


def _draw_pairs(axes: Axes, effects: list, ends: np.ndarray, channels: np.ndarray) -> None:
    """The pairs that an effect is on as chords with its number, drives as arrows, measuring pairs
    dotted; none for an effect on more than MOST_CHORDS. ends (n,): of chords at each electrode."""
    pair_labels: dict[tuple[int, int], list[int | str]] = {}
    for label, effect in effects:
        for kind, start, end in _effect_pairs(effect, channels):
            a, b = ends[start], ends[end]
            is_drive = kind == "drives"
            line = {"color": CULPRIT, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
            line |= {"arrowstyle": "-|>" if is_drive else "-"}
            line |= {"linestyle": "-" if is_drive else ":"}
            axes.annotate("", (b.real, b.imag), (a.real, a.imag), arrowprops=line)
            pair_labels.setdefault((start, end), []).append(label)
    for (start, end), labels in pair_labels.items():
        a, b = ends[start], ends[end]
        middle = 0.5 * (a + b) if abs(a + b) > 0.5 else 0.3 * a
        _draw_tags(axes, 0.93 * middle, -TAG_STEP * middle, labels)


def _effect_pairs(effect: dict, channels: np.ndarray) -> list[tuple[str, int, int]]:
    """The drives and measuring pairs that an effect is on: kind and two electrodes each."""
    pairs: list[tuple[str, int, int]] = []
    for kind, columns in (("drives", (0, 1)), ("measures", (2, 3))):
        affected = np.isin(channels[:, columns[0]], effect[kind])
        if len(effect[kind]) <= MOST_CHORDS:
            pairs += [(kind, *pair) for pair in np.unique(channels[affected][:, columns], axis=0)]
    if len(effect["channels"]) <= MOST_CHORDS // 2:  # a channel is two chords
        for source, sink, plus, minus in channels[effect["channels"]]:
            pairs += [("drives", source, sink), ("measures", plus, minus)]
    return pairs


def _draw_tags(axes: Axes, place: complex, step: complex, labels: Sequence[int | str]) -> None:
    """Labels in discs, one beside another from a place on; of more than MOST_TAGS the rest is
    counted."""
    if len(labels) > MOST_TAGS:
        labels = [*labels[: MOST_TAGS - 1], f"+{len(labels) - MOST_TAGS + 1}"]
    for k, label in enumerate(labels):
        _draw_tag(axes, place + k * step, label)


def _draw_tag(axes: Axes, place: complex, label: int | str) -> None:
    box = {"boxstyle": "circle,pad=0.2", "facecolor": CULPRIT, "edgecolor": "white"}
    white: dict[str, Any] = {"color": "white", "weight": "bold", "fontsize": 6}
    axes.text(place.real, place.imag, str(label), bbox=box | {"linewidth": 0.5}, **white, **CENTRED)


def has_hidden_errors(evidence: Evidence) -> bool:
    """Whether the folder has the errors of readings that decided nothing."""
    return bool(np.isfinite(evidence.last_before_V).any())


def is_corrected(evidence: Evidence) -> bool:
    """Whether the simulation after is another than before."""
    return bool(evidence.diagnosis["effects"] or evidence.diagnosis.get("families"))


def hidden_error(evidence: Evidence) -> Figure:
    """Root mean square error of the simulation in every channel, in the unit of the readings, on
    those that decided nothing, before and after in one scale; one panel where nothing is
    corrected. Where there are none, on the others."""
    errors = [evidence.last_before_V, evidence.last_after_V]
    if not has_hidden_errors(evidence):
        residuals = evidence.residual_before, evidence.residual_after
        errors = [residual * evidence.noise_sd_V for residual in residuals]
    if not is_corrected(evidence):
        errors = errors[1:]
    cells = [matrix(evidence.channels, np.sqrt(_frame_mean(error**2))) for error in errors]
    factor, unit = prefixed(float(np.nanmax(cells)), evidence.reading_unit)
    norm = Normalize(0.0, float(np.nanmax(cells)) / factor)
    figure = column(62)
    figure.set_layout_engine("compressed", w_pad=0.02, h_pad=0.02)  # of maps of equal scales
    row = np.atleast_1d(figure.subplots(1, len(cells), sharey=True))
    titles = TITLES if len(cells) > 1 else (("error", REFERENCE),)
    for axes, panel, error, (title, colour) in zip(row, cells, errors, titles, strict=True):
        image = draw_matrix(axes, evidence.channels, panel / factor, norm, DARKENING)
        image.set_cmap(image.get_cmap().with_extremes(bad="white"))
        rms = float(np.sqrt(np.nanmean(error**2)))
        size = quantity(rms, evidence.reading_unit).removesuffix(UNITS["arbitrary"]).rstrip()
        axes.set_title(f"{title}: {size}", color=colour)
    row[0].set_ylabel("drive, source electrode")
    row[0].invert_yaxis()
    place: dict[str, Any] = {"location": "bottom", "aspect": 40, "shrink": 0.8, "pad": 0.03}
    bar = figure.colorbar(image, ax=row, **place)
    bar.set_label(f"error, root mean square, {unit}")
    bar.outline.set_linewidth(0.4)
    return figure


def residual_matrix(evidence: Evidence) -> Figure:
    """Mean residual of every channel over the frames, in noise units, before and after."""
    figure = column(58)
    row = figure.subplots(1, 2, sharey=True)
    images = draw_residual_matrices(row, evidence)
    if share_colours(images):
        label = f"recording {MINUS} simulation, mean over the frames,\n"
        draw_residual_scale(figure, images[0], row, f"{label}in units of the noise of a reading")
    else:
        label = "mean residual, in noise units;\na scale of its own"
        for axes, image in zip(row, images, strict=True):
            draw_residual_scale(figure, image, [axes], label)
    return figure


def draw_residual_matrices(row: Sequence[Axes], evidence: Evidence) -> list[QuadMesh]:
    """`residual_matrix` on two axes that share y, before and after, in one scale of colours unless
    their limits differ by more than LARGEST_SCALE_RATIO; a dash where the recording is well below
    the simulation."""
    residuals = evidence.residual_before, evidence.residual_after
    panels = [matrix(evidence.channels, _frame_mean(residual)) for residual in residuals]
    # Means of noise alone, of sd 1 / sqrt(N), stay in the palest third.
    noise_limit = 10 / np.sqrt(len(evidence.frames))
    limits = [
        _rounded_up(max(noise_limit, float(np.nanquantile(np.abs(panel), COLOUR_QUANTILE))))
        for panel in panels
    ]
    if max(limits) <= LARGEST_SCALE_RATIO * min(limits):
        limits = [max(limits)] * 2
    images = []
    for axes, panel, limit, residual, (title, colour) in zip(
        row, panels, limits, residuals, TITLES, strict=True
    ):
        norm = Normalize(-limit, limit)
        images.append(draw_matrix(axes, evidence.channels, panel, norm, DIVERGING))
        _draw_dashes(axes, panel, -PALEST_SHARE * limit, limit, DASH_POINTS)
        rms = number(float(np.sqrt(np.nanmean(residual**2))))
        axes.set_title(f"{title}: rms {rms}", color=colour)
    row[0].set_ylabel("drive, source electrode")
    row[0].invert_yaxis()
    return images


def _rounded_up(limit: float) -> float:
    """A limit rounded up to one digit, so that half of it is written with two."""
    power_of_ten = 10.0 ** np.floor(np.log10(limit))
    return float(np.ceil(limit / power_of_ten) * power_of_ten)


def share_colours(images: Sequence[QuadMesh]) -> bool:
    """Whether matrices have the same limits of colours."""
    return len({image.get_clim() for image in images}) == 1


def draw_residual_scale(figure: Figure, image: QuadMesh, row: Sequence[Axes], label: str) -> None:
    """The scale of colours of `draw_residual_matrices`, under the axes of a row."""
    limit = image.get_clim()[1]
    assert limit is not None
    is_wide = len(row) > 1
    place: dict[str, Any] = {"location": "bottom", "aspect": 40 if is_wide else 20, "shrink": 0.8}
    bar = figure.colorbar(image, ax=row, pad=0.03, extend="both", **place)
    ticks = [share * limit for share in ((-1, -0.5, 0.0, 0.5, 1) if is_wide else (-1, 0.0, 1))]
    bar.set_ticks(ticks, labels=[number(tick, 2) for tick in ticks])
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)


def draw_changes(evidence: Evidence) -> list[Figure | None]:
    """What each effect changes in the frame in which it changes most, to stand beside it; None
    where all changes are 0 or unknown."""
    with style():
        return [
            _change_figure(evidence.channels, change) if np.nan_to_num(change).any() else None
            for change in evidence.effect_changes
        ]


def _change_figure(channels: np.ndarray, change: np.ndarray) -> Figure:
    figure = sheet(50, 58)
    axes = figure.add_subplot()
    draw_change_matrix(figure, axes, channels, change, "in units of the noise of a reading")
    axes.set_ylabel("drive, source electrode")
    return figure


def draw_change_matrix(
    figure: Figure, axes: Axes, channels: np.ndarray, change: np.ndarray, label: str
) -> None:
    """A change (M,) of every channel (M, 4), symmetric colours, dashes where it falls, and its
    scale below."""
    cells = matrix(channels, change)
    limit = float(np.nanmax(np.abs(cells)))
    image = draw_matrix(axes, channels, cells, Normalize(-limit, limit), DIVERGING)
    axes.invert_yaxis()
    _draw_dashes(axes, cells, -FALL_SHARE * limit, limit, CHANGE_DASH_POINTS)
    draw_scale(figure, axes, image, label)


def _draw_dashes(
    axes: Axes, cells: np.ndarray, threshold: float, limit: float, points: float
) -> None:
    """A dash in each cell below a threshold, so that print and eyes without colours have its sign.

    limit: of the colours; points: area of all dashes of a row, points².
    """
    row, column_index = np.nonzero(cells < threshold)
    colours = np.where(cells[row, column_index] < -limit / 2, "white", DASH)
    size = points / max(cells.shape)
    axes.scatter(column_index, row, marker="_", c=colours, s=size, linewidths=0.5)


def draw_scale(figure: Figure, axes: Axes, image: QuadMesh, label: str) -> None:
    """The scale of colours under one matrix, with numbers at its ends and its middle."""
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=22, shrink=0.9, pad=0.03)
    ticks = [float(tick) for tick in bar.norm.inverse(np.array([0.0, 0.5, 1.0]))]
    bar.set_ticks(ticks, labels=[number(tick, 2) for tick in ticks])
    bar.ax.minorticks_off()
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)


def _frame_mean(residual: np.ndarray) -> np.ndarray:
    """(M,): mean over the frames; NaN for a channel that was always lost."""
    count = np.isfinite(residual).sum(axis=0)
    return np.nansum(residual, axis=0) / np.where(count, count, np.nan)


def misfit_force(evidence: Evidence) -> Figure | str:
    """Chi squared per reading of each frame against the force."""
    force = evidence.frames["force_N"].to_numpy(float)
    if not evidence.frames["touch"].any():
        return "No frame was touched: there is no misfit against force."
    if np.isnan(force[evidence.frames["touch"]]).all():
        return "Nobody measured the force: there is no misfit against it."
    return _misfit_figure(evidence, force, "force, N (0: untouched)")


def misfit_time(evidence: Evidence) -> Figure | str:
    """Chi squared per reading of each frame against time."""
    if len(evidence.frames) == 1:
        return "One frame was diagnosed: there is no misfit against time."
    if evidence.recording.metadata["clock"] == "index":
        figure = _misfit_figure(evidence, np.arange(len(evidence.frames), dtype=float), "frame")
        figure.axes[0].xaxis.set_major_locator(MaxNLocator("auto", integer=True))
        return figure
    return _misfit_figure(evidence, evidence.frames["time_s"].to_numpy(float), "time, s")


def misfit_place(evidence: Evidence) -> Figure | str:
    """Chi squared per reading of the touches at each place, a map over the skin."""
    chi2, is_mapped = _chi2_per_reading(evidence), _is_mapped(evidence)
    if not is_mapped.any():
        return "No touch of known place, force and probe: there is no map of the misfit."
    skin = skin_layout_of(evidence)
    touches = evidence.frames.loc[is_mapped, ["x_mm", "y_mm"]]
    columns = {title: misfit[is_mapped] for (title, _), misfit in zip(TITLES, chi2, strict=True)}
    places = touches.assign(**columns).groupby(["x_mm", "y_mm"], as_index=False).mean()
    misfits = places[["before", "after"]].to_numpy()
    # Colours hold all places, and 1, which noise alone gives, lies well within them.
    low, high = min(0.5, 0.9 * max(misfits.min(), 1e-3)), max(2.0, 1.1 * misfits.max())
    norm = LogNorm(low, high)
    figure = column(56)
    figure.set_layout_engine("compressed", w_pad=0.02, h_pad=0.02)  # of maps of equal scales
    row = figure.subplots(1, 2, sharey=True)
    dots: dict[str, Any] = {
        "s": float(np.clip(2500 / len(places), 3, 28)),  # points²: the dots of a grid do not touch
        "cmap": matplotlib.colormaps[SEQUENTIAL].resampled(STEPS),
        "linewidths": 0.2,
        "edgecolors": RIM,
        "rasterized": len(places) > MOST_VECTOR_DOTS,
    }
    for axes, (title, colour) in zip(row, TITLES, strict=True):
        outline(axes, skin.rim, skin.electrodes, ELECTRODE_POINTS)
        image = axes.scatter(places["x_mm"], places["y_mm"], c=places[title], norm=norm, **dots)
        axes.set_aspect("equal")
        axes.set_title(title, color=colour)
        axes.set_xlabel("x, mm")
    row[0].set_ylabel("y, mm")
    bar = figure.colorbar(image, ax=row, location="bottom", aspect=40, shrink=0.8, pad=0.03)
    log_ticks(bar.ax.xaxis, low, high, power)
    bar.set_label("χ² per reading, mean over a place's touches; noise alone: 1")
    bar.outline.set_linewidth(0.4)
    return figure


def unmapped_text(evidence: Evidence) -> str:
    """How many touched places the map of the misfit leaves out, and why, a sentence; "" for
    none."""
    touched = evidence.frames[evidence.frames["touch"]]
    places = touched[["x_mm", "y_mm"]].dropna().drop_duplicates()
    mapped = evidence.frames.loc[_is_mapped(evidence), ["x_mm", "y_mm"]].drop_duplicates()
    if not len(mapped) or len(mapped) == len(places):
        return ""
    return (
        f" It has {len(mapped)} of {len(places)} places: at the others every touch was put aside,"
        " or its force or probe is not known."
    )


def _is_mapped(evidence: Evidence) -> np.ndarray:
    """(N,): touched frames of known place whose misfit is known before and after."""
    has_place = evidence.frames[["x_mm", "y_mm"]].notna().all(axis=1)
    chi2 = np.array(_chi2_per_reading(evidence))
    return (evidence.frames["touch"] & has_place).to_numpy() & np.isfinite(chi2).all(axis=0)


def _chi2_per_reading(evidence: Evidence) -> list[np.ndarray]:
    """Before and after (N,): mean square of each frame's residuals in noise units, NaN where all
    are lost."""
    chi2 = []
    for residual in (evidence.residual_before, evidence.residual_after):
        count = np.isfinite(residual).sum(axis=1)
        chi2.append(np.nansum(residual**2, axis=1) / np.where(count, count, np.nan))
    return chi2


def _misfit_figure(evidence: Evidence, x: np.ndarray, label: str) -> Figure:
    """The misfit of each frame against x (N,), and its means over BINS."""
    figure = column(48)
    axes = figure.add_subplot()
    misfits = _chi2_per_reading(evidence)
    is_image = len(x) > MOST_VECTOR_DOTS
    for y, (title, colour), width, marker in zip(misfits, TITLES, (2.2, 1.2), MARKERS, strict=True):
        dots: dict[str, Any] = {"color": colour, "markersize": 3.4, "rasterized": is_image}
        axes.plot(x, y, ".", alpha=0.4, mew=0, **dots)
        centre, mean = _bin_means(x, y)
        line: dict[str, Any] = {"color": colour, "linewidth": width, "markersize": 3}
        axes.plot(centre, mean, f"-{marker}", label=title, **line)
    axes.axhline(1, color=REFERENCE, linewidth=0.7, linestyle=DASHED, label="noise alone")
    axes.set_xlabel(label)
    axes.set_ylabel("χ² per reading")
    axes.set_yscale("log")
    log_limits(axes.yaxis, np.concatenate(misfits), power)
    figure.legend(loc="outside upper center", ncols=3, borderpad=0.1, columnspacing=1.5)
    return figure


def _bin_means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean x and y of BINS bins with equally many frames; where x takes no more values than that,
    of the frames at each value."""
    is_finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[is_finite], y[is_finite]
    values, label = np.unique(x, return_inverse=True)
    if len(values) > BINS:
        label = np.empty(len(x), int)
        label[np.argsort(x, kind="stable")] = np.arange(len(x)) * BINS // len(x)
    count = np.bincount(label)
    return np.bincount(label, x) / count, np.bincount(label, y) / count


def last_misfit(evidence: Evidence) -> Figure:
    """Chi squared per degree of freedom of the `last_scores`, before and after; noise gives 1.
    Hollow: against white noise alone, where errors of the rig are part of the noise; a bar: before
    with these errors in the sizes that were learned without an effect."""
    scores = last_scores(evidence.diagnosis)
    misfits = [scores[f"chi2_per_dof_{title}"] for title, _ in TITLES]
    white_misfits = []
    if evidence.has_rig_errors:
        white_misfits = [scores[f"white_chi2_per_dof_{title}"] for title, _ in TITLES]
    figure = column(32 if white_misfits else 26)
    axes = figure.add_subplot()
    axes.axvline(1, color=REFERENCE, linewidth=0.7, linestyle=DASHED)
    for y, misfit, (_, colour), marker in zip((1, 0), white_misfits, TITLES, MARKERS, strict=False):
        axes.plot(misfit, y, marker, color=colour, markersize=6, markerfacecolor="white")
    for y, misfit, (_, colour), marker in zip((1, 0), misfits, TITLES, MARKERS, strict=True):
        axes.plot([1, misfit], [y, y], color=colour, linewidth=0.8, alpha=0.6, zorder=1)
        axes.plot(misfit, y, marker, color=colour, markersize=6)
        place: dict[str, Any] = {
            "xytext": (0, 4),
            "textcoords": "offset points",
            "ha": "center",
            "va": "bottom",
        }
        text = number(misfit)
        axes.annotate(text, (misfit, y), color=colour, weight="bold", bbox=PLAIN, **place)
    own = own_sizes_misfit(evidence)
    axes.set_xscale("log")
    shown = [*misfits, *white_misfits, *([] if own is None else [own])]
    span = np.array([*shown, min(misfits) / MISFIT_LABEL_ROOM])
    log_limits(axes.xaxis, span, power, room=MISFIT_LABEL_ROOM)
    if own is not None:
        axes.plot(own, 1, "|", color=TITLES[0][1], markersize=9)
    if white_misfits:
        dot: dict[str, Any] = {"marker": "o", "color": REFERENCE, "linestyle": "", "markersize": 5}
        hollow: dict[str, Any] = {"markerfacecolor": "white", "label": "white noise alone"}
        dots = [Line2D([], [], **dot, label="noise and rig"), Line2D([], [], **dot, **hollow)]
        if own is not None:
            bar = dot | {"marker": "|", "markersize": 8, "label": "rig as learned before"}
            dots.append(Line2D([], [], **bar))
        figure.legend(handles=dots, loc="outside upper center", ncols=2, borderpad=0.1)
    axes.set(ylim=(-0.5, 1.8), yticks=[1, 0], yticklabels=[title for title, _ in TITLES])
    source = "noise and rig" if white_misfits else "noise"
    axes.set_xlabel(f"held-out χ² per degree of freedom; {source} alone: 1")
    for tick, (_, colour) in zip(axes.get_yticklabels(), TITLES, strict=True):
        tick.set_color(colour)
    return figure


def rivals(evidence: Evidence) -> Figure | str:
    """Chi squared of frames held out in turn: of all effects, without one of them, and with another
    name in its place."""
    table = evidence.tables["rivals"]
    if table.empty:
        return "No effect was named: there is none to take out or to replace."
    is_whole_set = table["effect"] == ""
    misfits = table["chi2_per_dof"][is_whole_set]
    rows = [("all that is named", misfit, None, AFTER) for misfit in misfits]
    for effect, group in table[~is_whole_set].groupby("effect", sort=False):
        is_removal = group["instead"] == "nothing"
        for _, row in group[is_removal].iterrows():
            rows.append((f"without {effect}", row["chi2_per_dof"], row["elpd_difference"], BEFORE))
        ranking = group[~is_removal].sort_values("elpd_difference", ascending=False, kind="stable")
        for _, row in ranking.head(MOST_RIVALS).iterrows():
            name = f"{row['instead']} instead"
            rows.append((name, row["chi2_per_dof"], row["elpd_difference"], QUIET))
    figure = column(12 + 6.5 * len(rows))
    axes = figure.add_subplot()
    axes.spines["left"].set_visible(False)
    axes.axvline(1, color=REFERENCE, linewidth=0.7, linestyle=DASHED)
    for y, (name, misfit, elpd, colour) in enumerate(rows):
        axes.plot([rows[0][1], misfit], [y, y], color=colour, linewidth=0.8, alpha=0.6)
        axes.plot(misfit, y, "o", color=colour, markersize=4)
        text = number(misfit) if elpd is None else f"{number(misfit)} ({number(elpd)} nats)"
        place: dict[str, Any] = {
            "textcoords": ("axes fraction", "data"),
            "va": "center",
            "color": colour,
        }
        axes.annotate(name, (misfit, y), xytext=(0, y - 0.45), ha="left", bbox=PLAIN, **place)
        axes.annotate(text, (misfit, y), xytext=(1, y - 0.45), ha="right", bbox=PLAIN, **place)
    axes.set_xscale("log")
    log_limits(axes.xaxis, np.array([misfit for _, misfit, *_ in rows]), power)
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
    if GAP_ROOM * gaps.max() > LARGEST_LINEAR_GAP:
        gaps = np.maximum(gaps, SMALLEST_GAP)
        axes.set_xscale("log")
        log_limits(axes.xaxis, gaps, power, room=GAP_ROOM)
    else:
        axes.set_xlim(0, GAP_ROOM * max(DISTINCT.threshold, gaps.max()))
    axes.axvspan(axes.get_xlim()[0], DISTINCT.threshold, color="#e4e4e4", linewidth=0)
    for y, (pair, ends) in enumerate(zip(pairs, gaps, strict=True)):
        arrow = {"arrowstyle": "-|>", "color": REFERENCE, "linewidth": 1, "shrinkA": 3}
        axes.annotate("", (ends[1], y), (ends[0], y), arrowprops=arrow | {"shrinkB": 3})
        axes.plot(ends[0], y, "o", color=REFERENCE, markersize=5, markerfacecolor="white")
        axes.plot(ends[1], y, "o", color=REFERENCE, markersize=5)
        for word, gap, height in zip(("now", "then"), ends, (5, -11), strict=True):
            x = axes.transLimits.transform(axes.transScale.transform((gap, y)))[0]
            side = "left" if x < 0.1 else "right" if x > 0.9 else "center"
            text = f"{word} {number(pair[f'gap_{word}'], 2)}"
            place: dict[str, Any] = {"xytext": (0, height), "textcoords": "offset points"}
            axes.annotate(text, (gap, y), fontsize=6.5, ha=side, **place)
    axes.set(ylim=(len(pairs) - 0.3, -0.7), yticks=range(len(pairs)))
    axes.set_yticklabels([f"{pair['a']}\nor {pair['b']}" for pair in pairs])
    axes.set_xlabel("gap, in noise units")
    return figure


FIGURES = {
    "hidden": hidden_error,
    "electrodes": electrode_ring,
    "residual_matrix": residual_matrix,
    "misfit_force": misfit_force,
    "misfit_time": misfit_time,
    "misfit_place": misfit_place,
    "last": last_misfit,
    "rivals": rivals,
    "next_experiment": next_experiment,
}
