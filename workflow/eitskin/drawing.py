"""What the paper's figures share: their widths, the disc, and the files of each."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eitskin.atomic import atomic_path
from eitskin.diagnose.figures import png, svg

COLUMN_MM, FULL_MM = 88.0, 180.0
RIM, ELECTRODE = "#404040", "#202020"


def sheet(width_mm: float, height_mm: float) -> Figure:
    """An empty figure; to be drawn within `diagnose.figures.style`."""
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
    FigureCanvasAgg(figure)
    return figure


def disc(axes: Axes, radius_mm: float, electrode_deg: np.ndarray) -> None:
    """The rim and the electrodes, in mm, equal scales."""
    circle = radius_mm * np.exp(2j * np.pi * np.linspace(0, 1, 181))
    axes.plot(circle.real, circle.imag, color=RIM, linewidth=0.6)
    rim = radius_mm * np.exp(1j * np.radians(np.asarray(electrode_deg)))
    axes.plot(rim.real, rim.imag, "s", color=ELECTRODE, markersize=1.6)
    axes.set_aspect("equal")


def write(
    figure: Figure, table: pd.DataFrame, vector: str | Path, image: str | Path, csv: str | Path
) -> None:
    """The figure as SVG and PNG and its numbers as CSV."""
    with atomic_path(vector) as path:
        path.write_text(svg(figure), encoding="utf-8")
    with atomic_path(image) as path:
        path.write_bytes(png(figure))
    with atomic_path(csv) as path:
        table.to_csv(path, index=False, float_format="%.6g")
