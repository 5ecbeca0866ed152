"""A figure as files: SVG, PNG and its numbers."""

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from eitskin.atomic import atomic_path
from eitskin.plotting import png, svg


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
