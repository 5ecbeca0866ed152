"""The forward model's own numerical error, known channel by channel.

It is the same in every frame of a recording, so it adds up coherently and cannot be treated as
noise; what is returned here is therefore signed, per channel. The limit that errors are measured
against is Richardson's: three expansions, each with twice the electrode modes of the one before,
extrapolated at the order that they show.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from eitskin.atomic import atomic_path
from eitskin.forward import ACCURACIES, Accuracy, Forward, channel_values
from eitskin.geometry import Geometry
from eitskin.mesh import polar_grid
from eitskin.protocol import channel_table
from eitskin.touch import TouchAccuracy

MODES = (16, 32, 64)
FINEST = Accuracy(MODES[-1], TouchAccuracy(40, 1e-11, 16, 2e-4), MODES[-1])
PROBES_MM = (7.0, 10.0, 15.0)
CONTRASTS = (0.45, 9.0)
OUT = Path("results/accuracy.csv")


def electrode_limit(geometry: Geometry, channels: np.ndarray) -> tuple[np.ndarray, float]:
    """Untouched voltages (M,) V per A, extrapolated in electrode modes, and the order observed.

    Order q: the error falls as modes^-q. Point electrodes have a closed form,
    order infinite; where rounding is all that is left of the error, the order is NaN.
    """
    if geometry.points:
        return Forward(geometry, FINEST).voltages(channels), np.inf
    coarse, middle, fine = (
        channel_values(
            Forward(geometry, replace(FINEST, electrode_order=n, most_modes=n)).transfer(), channels
        )
        for n in MODES
    )
    if np.linalg.norm(fine - middle) < 1e-11 * np.linalg.norm(fine):
        return fine, np.nan
    ratio = np.linalg.norm(middle - coarse) / np.linalg.norm(fine - middle)
    return fine + (fine - middle) / (ratio - 1.0), float(np.log2(ratio))


def untouched_error(
    geometry: Geometry, channels: np.ndarray, accuracy: str | Accuracy
) -> np.ndarray:
    """(M,) V per A, signed: what `accuracy` gives minus the limit, the same in every frame."""
    limit = electrode_limit(geometry, channels)[0]
    return Forward(geometry, accuracy).voltages(channels) - limit


def touch_error(
    geometry: Geometry,
    channels: np.ndarray,
    accuracy: str | Accuracy,
    place: tuple[float, float, float],
    contrasts: tuple[float, ...] = CONTRASTS,
) -> np.ndarray:
    """(contrasts, M) V per A, signed: error of a touch's change at (x_mm, y_mm, radius_mm)."""
    found, finest = (
        Forward(geometry, a).place(*place).channel_change(channels, contrasts)
        for a in (accuracy, FINEST)
    )
    return found - finest


def table(geometries: dict[str, Geometry]) -> pd.DataFrame:
    """One row a skin and named accuracy: RMS error over channels of the median |v|, and the largest
    relative error of a touch's change over the paper's 192 places and three probes."""
    rows = []
    n = len(next(iter(geometries.values())).electrode_deg)
    channels = channel_table(n)
    driven = np.array([(k, (k + 1) % n, (k + 1) % n, (k + 2) % n) for k in range(n)])
    for name, geometry in geometries.items():
        limit, order = electrode_limit(geometry, channels)
        driven_limit, driven_order = (
            (np.nan, np.nan) if geometry.points else electrode_limit(geometry, driven)
        )
        finest = Forward(geometry, FINEST)
        forwards = {a: Forward(geometry, a) for a in ACCURACIES}
        worst = dict.fromkeys(ACCURACIES, 0.0)
        grid = polar_grid(geometry.radius_mm, 8, 24, 0.1, 0.9, 0.0)
        places = [
            (x, y, p / 2) for p in PROBES_MM for x, y in zip(grid.x_mm, grid.y_mm, strict=True)
        ]
        for place in tqdm(places, desc=name, disable=not sys.stderr.isatty()):
            true = finest.place(*place).channel_change(channels, CONTRASTS)
            for accuracy, forward in forwards.items():
                change = forward.place(*place).channel_change(channels, CONTRASTS)
                error = np.linalg.norm(change - true, axis=1) / np.linalg.norm(true, axis=1)
                worst[accuracy] = max(worst[accuracy], float(error.max()))
        for accuracy, forward in forwards.items():
            error = forward.voltages(channels) - limit
            median = np.median(np.abs(limit))
            driven_error = np.nan
            if not geometry.points:
                values = channel_values(forward.transfer(), driven)
                driven_error = np.abs(values / driven_limit - 1.0).max()
            rows.append(
                {
                    "skin": name,
                    "accuracy": accuracy,
                    "rms_error_of_median_v": float(np.sqrt((error**2).mean()) / median),
                    "touch_error": worst[accuracy],
                    "order_in_modes": order,
                    "driven_electrode_error": driven_error,
                    "driven_electrode_order": driven_order,
                }
            )
    return pd.DataFrame(rows)


def main() -> None:
    """Print the table for skins from easy to hard contacts and write it to results/accuracy.csv."""
    angles = np.arange(16) * 22.5
    geometries = {
        "points": Geometry(80.0, 3.0, 0.5, angles, 0.0, 0.0),
        **{
            f"5 mm, {z:g} ohm m2": Geometry(80.0, 3.0, 0.5, angles, 5.0, z)
            for z in (1e-2, 2e-3, 5e-4)
        },
        "14 mm, 0.0001 ohm m2": Geometry(80.0, 3.0, 0.5, angles, 14.0, 1e-4),
    }
    result = table(geometries)
    with atomic_path(OUT) as temporary:
        result.to_csv(temporary, index=False)
    print(result.to_string(index=False, float_format=lambda v: f"{v:.2g}"))
    print(f"written to {OUT}")


if __name__ == "__main__":
    main()
