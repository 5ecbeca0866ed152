"""The numerical error of the forward model, on skins from easy to hard contacts."""

import numpy as np
import pandas as pd

from benchmark.rows import ROOT
from eitskin.atomic import atomic_path
from eitskin.physics.accuracy import CONTRASTS, FINEST, electrode_limit
from eitskin.physics.forward import ACCURACIES, Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.progress import patient
from eitskin.simulate.layout import polar_grid

PROBES_MM = (7.0, 10.0, 15.0)  # diameters: over the range of usual probes
CSV = ROOT / "benchmarks" / "accuracy.csv"


def table(geometries: dict[str, Geometry]) -> pd.DataFrame:
    """One row for each skin and named accuracy: RMS error over channels relative to the median |v|,
    and the largest relative error of a touch's change over the paper's 192 places and three probes.
    """
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
            (x, y, probe_mm / 2)
            for probe_mm in PROBES_MM
            for x, y in zip(grid.x_mm, grid.y_mm, strict=True)
        ]
        for place in patient(places, f"{name}, places"):
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
                values = channel_values(forward.transfer_impedance(), driven)
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
    """Print the table for skins from easy to hard contacts; write it to benchmarks/accuracy.csv."""
    angles = np.arange(16) * 22.5
    per_electrode = np.ones(len(angles))
    geometries = {
        "points": Geometry(80.0, 3.0, 0.5, angles, 0.0 * per_electrode, 0.0 * per_electrode),
        **{
            f"5 mm, {z:g} ohm m2": Geometry(
                80.0, 3.0, 0.5, angles, 5.0 * per_electrode, z * per_electrode
            )
            for z in (1e-2, 2e-3, 5e-4)
        },
        "14 mm, 0.0001 ohm m2": Geometry(
            80.0, 3.0, 0.5, angles, 14.0 * per_electrode, 1e-4 * per_electrode
        ),
    }
    result = table(geometries)
    with atomic_path(CSV) as temporary:
        result.to_csv(temporary, index=False)
    print(result.to_string(index=False, float_format=lambda v: f"{v:.2g}"))
    print(f"written to {CSV}")


if __name__ == "__main__":
    main()
