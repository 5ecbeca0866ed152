"""The style of all figures: colours, widths, fonts; their bytes are reproducible."""

import contextlib
import io
import re
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

BEFORE, AFTER = "#d55e00", "#0072b2"  # Okabe & Ito: distinguishable for all readers, and in print
MARKERS = ("s", "o")  # of before and after: distinguishable without colours
CULPRIT, QUIET = "#8b1a6b", "#767676"
DIVERGING, SEQUENTIAL, STEPS = "PuOr_r", "cividis", 41
WIDTH_IN = 85 / 25.4
DPI = 220
COLUMN_MM, FULL_MM = 88.0, 180.0
HEADROOM = 0.05  # of a logarithmic axis, free above the largest value: no marker is cut
DISC_MARGIN = 1.05  # of a disc's radius
RIM, ELECTRODE = "#404040", "#202020"
UNREAD = "#c8c8c8"  # channels without readings
PLAIN = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}  # behind a text on a line
CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
STYLE: dict[Any, Any] = {
    "figure.dpi": DPI,
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.w_pad": 0.02,
    "figure.constrained_layout.h_pad": 0.02,
    "svg.fonttype": "path",
    "svg.hashsalt": "eitskin",
    "font.family": "DejaVu Sans",
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Matplotlib's settings for every figure."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def svg(figure: Figure | str) -> str:
    """The figure as SVG, the same text for the same figure; of a sentence, a figure of the
    sentence."""
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with style():
        _as_figure(figure).savefig(stream, format="svg", metadata=nothing)
    return _with_steady_clips(stream.getvalue())


def _with_steady_clips(text: str) -> str:
    """The SVG with clip paths named by content and order; Matplotlib names them by memory
    addresses."""
    clip_names = re.findall(r'<clipPath id="(\w+)"', text)

    def renamed(start: str) -> str:
        names = {name: f"{start}{k}" for k, name in enumerate(clip_names)}
        mention = r'(?<=<clipPath id=")\w+|(?<=url\(#)\w+'
        return re.sub(mention, lambda m: names.get(m[0], m[0]), text)

    return renamed(f"clip{zlib.crc32(renamed('clip').encode()):08x}_")


def png(figure: Figure | str) -> bytes:
    """The figure as PNG, the same bytes for the same figure; of a sentence, a figure of the
    sentence."""
    stream = io.BytesIO()
    with style():
        _as_figure(figure).savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    return stream.getvalue()


def _as_figure(figure: Figure | str) -> Figure:
    if isinstance(figure, Figure):
        return figure
    page = column(12)
    page.text(0.5, 0.5, figure, ha="center", va="center", wrap=True)
    return page


def column(height_mm: float) -> Figure:
    """An empty figure, as wide as a column; to be drawn within `style`."""
    figure = Figure(figsize=(WIDTH_IN, height_mm / 25.4))
    FigureCanvasAgg(figure)
    return figure


def sheet(width_mm: float, height_mm: float) -> Figure:
    """An empty figure; to be drawn within `style`."""
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
    FigureCanvasAgg(figure)
    return figure


def disc(axes: Axes, radius_mm: float, electrode_deg: np.ndarray) -> None:
    """The rim and the electrodes, in mm, equal scales."""
    circle = radius_mm * np.exp(2j * np.pi * np.linspace(0, 1, 181))
    outline(axes, circle, radius_mm * np.exp(1j * np.radians(np.asarray(electrode_deg))))


def outline(
    axes: Axes, rim: np.ndarray, electrodes: np.ndarray, marker_points: float = 1.6
) -> None:
    """A closed rim (K,) and electrodes (n,), complex places in mm, equal scales; marker_points: of
    an electrode's square, in points."""
    axes.plot(rim.real, rim.imag, color=RIM, linewidth=0.6)
    axes.plot(electrodes.real, electrodes.imag, "s", color=ELECTRODE, markersize=marker_points)
    axes.set_aspect("equal")


def leave_room(axes: Axes, radius_mm: float, centre: complex = 0j) -> None:
    """Limits around a disc, or a square of this half extent about `centre`, at which no electrode
    is cut."""
    reach = DISC_MARGIN * radius_mm
    x, y = centre.real, centre.imag
    axes.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach))


def matrix(channels: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(drives, measuring pairs): a value (M,) of each of the channels (M, 4), the mean where
    several share a place, NaN where there is none."""
    drives, row = pairs(channels, (0, 1))
    measures, column = pairs(channels, (2, 3))
    is_finite = np.isfinite(value)
    total, count = np.zeros((2, len(drives), len(measures)))
    np.add.at(total, (row[is_finite], column[is_finite]), value[is_finite])
    np.add.at(count, (row[is_finite], column[is_finite]), 1)
    return total / np.where(count, count, np.nan)


def pairs(channels: np.ndarray, columns: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(P, 2): the different pairs in two columns of channels (M, 4), sorted; (M,): the index of
    each channel's pair."""
    unique_pairs, index = np.unique(channels[:, columns], axis=0, return_inverse=True)
    return unique_pairs, index.ravel()


def draw_matrix(
    axes: Axes, channels: np.ndarray, cells: np.ndarray, norm: Normalize, colours: str
) -> QuadMesh:
    """A `matrix` of channels (M, 4) in colours; drives go downwards once the axis is turned."""
    edges = np.arange(cells.shape[1] + 1) - 0.5, np.arange(cells.shape[0] + 1) - 0.5
    steps = matplotlib.colormaps[colours].resampled(STEPS).with_extremes(bad=UNREAD)
    shown = np.ma.masked_invalid(cells)
    image = axes.pcolormesh(*edges, shown, cmap=steps, norm=norm, edgecolor="face", lw=0.1)
    axes.set_aspect("equal")
    axes.spines[:].set_visible(True)
    axes.set_xlabel("measuring pair, + electrode")
    _pair_ticks(axes.xaxis, pairs(channels, (2, 3))[0])
    _pair_ticks(axes.yaxis, pairs(channels, (0, 1))[0])
    return image


def _pair_ticks(axis: Axis, shown: np.ndarray) -> None:
    step = -(-len(shown) // 5) if len(shown) != 16 else 4
    positions = np.arange(0, len(shown), step)
    unique = len(np.unique(shown[:, 0])) == len(shown)
    axis.set_ticks(positions, [str(a) if unique else f"{a}, {b}" for a, b in shown[positions]])


def log_limits(
    axis: Axis, values: np.ndarray, label: Callable[[float], str], room: float = 1.15
) -> None:
    """Limits of a logarithmic axis that include `values` and 0.5 to 2; above the largest value a
    factor `room`, or more on a long axis. label: text of a tick."""
    values = values[np.isfinite(values) & (values > 0)]
    low, largest = min(0.5, values.min(initial=1.0) / 1.15), values.max(initial=1.0)
    high = max(2.0, largest * max(room, (largest / low) ** HEADROOM))
    (axis.axes.set_xlim if isinstance(axis, XAxis) else axis.axes.set_ylim)(low, high)
    log_ticks(axis, low, high, label)


def log_ticks(axis: Axis, low: float, high: float, label: Callable[[float], str]) -> None:
    """A few plain ticks on a logarithmic axis from `low` to `high`, labelled by `label`."""
    is_short = high / low < 300
    axis.set_major_locator(
        LogLocator(subs=(1, 2, 5) if is_short else (1,), numticks=8 if is_short else 5)
    )
    axis.set_major_formatter(FuncFormatter(lambda value, _: label(value)))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
