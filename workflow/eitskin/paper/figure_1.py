"""Figure 1: a frame, its changes by a press, and the conductivity reconstructed from them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from eitskin import figure_files, plotting, skin_layout
from eitskin.data import alignment, baseline, reconstruct, unit_disc
from eitskin.data.recording import Recording, presses
from eitskin.data.unit_disc import UnitDisc
from eitskin.errors import InputError
from eitskin.physics.skin import Skin
from eitskin.plotting import AFTER, CENTRED, CULPRIT, DIVERGING, style

SHOWN = 4  # frames of the press: as many images fit the column
ACROSS = 48  # pixels over the disc: finer than the resolution of 16 electrodes
MILLI = 1e3


@dataclass(frozen=True)
class Press:
    """K touched frames of one press, weakest first, and their images on `places` (G,), in half
    extents of the skin about its middle.

    untouched (M,), change (K, M) in `unit`; `noser` (K, G) relative rise of the conductivity;
    `projected` (K, G), of the largest; force_N (K,), NaN where unknown; place in mm.
    """

    frame: np.ndarray
    force_N: np.ndarray
    place: complex
    skin: Skin
    unit: str
    untouched: np.ndarray
    change: np.ndarray
    places: np.ndarray
    noser: np.ndarray
    projected: np.ndarray
    strength: float


def press(recording: Recording, name: str) -> Press:
    """The press that is drawn: the longest of those nearest to half the radius of the unit disc of
    the skin, with SHOWN frames, evenly spaced.

    The strength of the prior is chosen on all its frames. Raises InputError for a recording without
    absolute readings or touch, and for a skin whose size or electrodes are not stated.
    """
    skin, metadata = recording.skin, recording.metadata
    has_outline = skin.rim is not None
    for key in () if has_outline else ("radius_mm", "electrode_deg"):
        if getattr(skin, key) is None:
            raise InputError(name, f"skin.{key}", "null", "a value, to draw the skin")
    disc = unit_disc.unit_disc(skin)
    if recording.voltage is None or metadata["values"] != "absolute":
        content = "a query" if recording.voltage is None else "differences"
        raise InputError(name, "voltage_V", content, "absolute readings")
    label = presses(recording)
    position = recording.frames["x_mm"].to_numpy() + 1j * recording.frames["y_mm"].to_numpy()
    touched = np.flatnonzero((label >= 0) & np.isfinite(position))
    if not len(touched):
        raise InputError(name, "column touch", "no touch at a known place", "at least one")
    radius_deviation = np.abs(np.abs(disc.mapped(position[touched])[0]) - 0.5)
    nearest_frames = touched[radius_deviation <= radius_deviation.min() + 1e-9]
    longest = np.bincount(label[nearest_frames]).argmax()
    rows = nearest_frames[label[nearest_frames] == longest]

    ideal = alignment.homogeneous_readings(recording.channels, disc.electrode_deg)
    untouched_frames = recording.voltage[~recording.frames["touch"].to_numpy(bool)]
    change = baseline.changes(recording, name)[rows]
    measured = (
        np.isfinite(ideal)
        & np.isfinite(change).all(axis=0)
        & np.isfinite(untouched_frames).any(axis=0)
    )
    sign = np.sign(ideal) if metadata["voltage"] == "magnitude" else np.ones(len(ideal))
    untouched = np.nanmean(np.where(measured, untouched_frames, 0.0), axis=0)
    ideal, signed = ideal[measured], (sign * untouched)[measured]
    scale = (ideal @ signed) / (ideal @ ideal)
    places, jacobian = _pixels(skin, disc, recording.channels[measured])
    relative = (sign * change)[:, measured] / scale
    strength = reconstruct.strength(jacobian, relative)
    images = relative @ reconstruct.noser(jacobian, strength).T
    projected = alignment.back_projection(jacobian.T, relative).T
    drawn_frames = np.linspace(0, len(rows) - 1, min(SHOWN, len(rows))).round().astype(int)
    return Press(
        frame=recording.frames["frame"].to_numpy()[rows[drawn_frames]],
        force_N=recording.frames["force_N"].to_numpy()[rows[drawn_frames]],
        place=complex(position[rows[0]]),
        skin=skin,
        unit=metadata["unit"],
        untouched=np.where(measured, untouched, np.nan),
        change=np.where(measured, change[drawn_frames], np.nan),
        places=places,
        noser=images[drawn_frames],
        projected=projected[drawn_frames] / np.abs(projected[drawn_frames]).max(),
        strength=strength,
    )


def _pixels(skin: Skin, disc: UnitDisc, channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (G,) over the skin, in half extents about its middle, and the change (M, G) of each
    reading per relative rise of the conductivity in each."""
    if skin.rim is None:
        places = reconstruct.pixels(ACROSS)
        return places, reconstruct.jacobian(channels, disc.electrode_deg, places, ACROSS)
    extent, place_mm = skin_layout.stated_layout(skin), reconstruct.skin_pixels(skin, ACROSS)
    image, slope = disc.mapped(place_mm)
    area = (extent.half_extent_mm * slope) ** 2
    on_disc = reconstruct.jacobian(channels, disc.electrode_deg, image, ACROSS)
    return extent.scaled(place_mm), on_disc * area


def table(press: Press) -> pd.DataFrame:
    """The numbers of the figure: panel, frame, force_N, channel or x_mm and y_mm, value, unit."""
    parts = [_channels("untouched frame", -1, 0.0, press.untouched, press.unit)]
    extent = skin_layout.stated_layout(press.skin)
    place_mm = extent.centre + extent.half_extent_mm * press.places
    for k, (frame, force) in enumerate(zip(press.frame, press.force_N, strict=True)):
        parts.append(_channels("change", frame, force, press.change[k], press.unit))
        for panel, image in (("noser", press.noser), ("back-projection", press.projected)):
            columns = {"x_mm": place_mm.real, "y_mm": place_mm.imag, "value": image[k], "unit": "1"}
            parts.append(
                pd.DataFrame({"panel": panel, "frame": frame, "force_N": force, **columns})
            )
    return pd.concat(parts, ignore_index=True)


def _channels(panel: str, frame: int, force: float, value: np.ndarray, unit: str) -> pd.DataFrame:
    head = {"panel": panel, "frame": frame, "force_N": force}
    return pd.DataFrame({**head, "channel": np.arange(len(value)), "value": value, "unit": unit})


def draw(press: Press) -> Figure:
    """Frame, changes, and two rows of images, one column for each force."""
    factor, unit = (MILLI, "mV") if press.unit == "V" else (1.0, press.unit)
    count = len(press.frame)
    with style():
        figure = plotting.sheet(plotting.COLUMN_MM, 90.0 + 9.0 * count)
        (upper,), (lower,) = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.3, 0.9))
        ratios = [2.0, *[1.0] * count]
        frame, *changes = upper.subplots(1 + count, 1, sharex=True, height_ratios=ratios)
        channel = np.arange(len(press.untouched))
        frame.plot(channel, factor * press.untouched, color=plotting.ELECTRODE, linewidth=0.6)
        frame.set_ylabel(unit)
        frame.set_title("(a) untouched", loc="left")
        labels = [
            f"{force:.1f} N" if np.isfinite(force) else f"frame {number}"
            for number, force in zip(press.frame, press.force_N, strict=True)
        ]
        largest = 1.05 * factor * float(np.nanmax(np.abs(press.change)))
        for axes, change, label in zip(changes, press.change, labels, strict=True):
            axes.plot(channel, factor * change, color=AFTER, linewidth=0.6)
            axes.set_ylim(-largest, largest)
            axes.text(1.01, 0.5, label, transform=axes.transAxes, va="center")
        changes[0].set_title("(b) change by a press, one scale", loc="left")
        changes[count // 2].set_ylabel(unit)
        changes[-1].set_xlabel("channel")
        changes[-1].set_xlim(0, len(channel) - 1)
        upper.align_ylabels()
        extent = skin_layout.stated_layout(press.skin)
        rows = lower.subplots(2, count, squeeze=False, sharex=True, sharey=True)
        for images, row, name, bar in (
            (press.noser, rows[0], "(c) NOSER", "rise of conductivity"),
            (press.projected, rows[1], "(d) back-proj.", "rise / largest"),
        ):
            limit = float(np.abs(images).max())
            for axes, image, label in zip(row, images, labels, strict=True):
                mesh = _draw_image(axes, press, image, limit)
                if images is press.noser:
                    axes.set_title(label)
            left = extent.centre.real - 1.22 * extent.half_extent_mm
            row[0].text(left, extent.centre.imag, name, rotation=90, **CENTRED)
            legend = lower.colorbar(mesh, ax=list(row), aspect=11, pad=0.02)
            legend.set_label(bar)
            legend.outline.set_linewidth(0.4)
    return figure


def _draw_image(axes: Axes, press: Press, image: np.ndarray, limit: float) -> QuadMesh:
    grid = np.full((ACROSS, ACROSS), np.nan)
    step = 2.0 / ACROSS
    column = ((press.places.real + 1.0) / step).astype(int)
    row = ((press.places.imag + 1.0) / step).astype(int)
    grid[row, column] = image
    extent = skin_layout.stated_layout(press.skin)
    edge = extent.half_extent_mm * np.linspace(-1.0, 1.0, ACROSS + 1)
    mesh = axes.pcolormesh(
        extent.centre.real + edge,
        extent.centre.imag + edge,
        np.ma.masked_invalid(grid),
        cmap=DIVERGING,
        norm=Normalize(-limit, limit),
        rasterized=True,
    )
    skin_layout.draw(axes, press.skin)
    axes.plot(press.place.real, press.place.imag, "+", color=CULPRIT, markersize=5, mew=0.9)
    axes.set_axis_off()
    return mesh


def write(recording: Recording, name: str, vector: Path, image: Path, csv: Path) -> None:
    """Figure 1 of a recording; raises InputError as `press` does."""
    shown_press = press(recording, name)
    figure_files.write(draw(shown_press), table(shown_press), vector, image, csv)
