"""The layout of a simulated set: electrode nodes, touched places and force levels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.state_priors import force_N


def polar_grid(
    radius_mm: float, radii: int, angles: int, inner: float, outer: float, probe_mm: float
) -> pd.DataFrame:
    """The paper's touch grid: place, x_mm, y_mm, radius_mm; radii `inner` to `outer` of the
    skin's."""
    r = radius_mm * np.repeat(np.linspace(inner, outer, radii), angles)
    phi = np.tile(2.0 * np.pi * np.arange(angles) / angles, radii)
    return pd.DataFrame(
        {
            "place": np.arange(radii * angles),
            "x_mm": r * np.cos(phi),
            "y_mm": r * np.sin(phi),
            "radius_mm": 0.5 * probe_mm,
        }
    )


def force_levels(
    seed: int, mean_N: float, sd_N: float, max_N: float, levels: int, decimals: int
) -> np.ndarray:
    """(levels,) N, ascending: normal, clipped to 0 ... max_N, rounded, all different.

    Raises InputError where rounding leaves too few different levels.
    """
    rng = np.random.default_rng([seed, 1])
    step = 10.0**-decimals
    if levels > max_N / step + 1.0:
        expected = f"at most {int(max_N / step) + 1} at {decimals} decimals up to {max_N:g} N"
        raise InputError("config", "forces.levels", levels, expected)
    levels_N: np.ndarray = np.zeros(0)
    for _ in range(1000):
        sample_N = force_N(rng.standard_normal(levels), mean_N, sd_N, max_N)
        unique = np.unique(np.round(np.concatenate([levels_N, sample_N]) / step).astype(int) * step)
        if len(unique) >= levels:
            selection = rng.choice(len(unique), levels, replace=False)
            return np.round(unique[np.sort(selection)], decimals)
        levels_N = unique
    raise InputError(
        "config", "forces.levels", levels, f"at most {len(levels_N)} at {decimals} decimals"
    )


@dataclass(frozen=True)
class Layout:
    """Blocks of the configuration that a simulated set is laid out by."""

    seed: int
    skin: dict
    protocol: dict
    touch_grid: dict
    forces: dict
    accuracy: str


def write(mesh: str | Path, places: str | Path, layout: Layout) -> None:
    """Write `mesh` (npz: channels, force_N, electrode node angles and weights) and `places` (CSV).

    Raises InputError where the blocks make no skin that can be measured.
    """
    believed = Skin.from_metadata(layout.skin, "config.yaml")
    geometry = Geometry.from_skin(believed)
    channels = channel_table(len(geometry.electrode_deg), **layout.protocol)
    forward = Forward(geometry, layout.accuracy)
    forward.voltages(channels)
    grid = polar_grid(geometry.radius_mm, **layout.touch_grid)
    levels = force_levels(layout.seed, **layout.forces)
    with atomic_path(places) as temporary:
        grid.to_csv(temporary, index=False, float_format="%.17g")
    with atomic_path(mesh) as temporary, open(temporary, "wb") as file:
        np.savez(
            file,
            channels=channels,
            force_N=levels,
            electrode_theta_rad=forward.electrodes.theta,
            electrode_weight=forward.electrodes.weight,
        )
