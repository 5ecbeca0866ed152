"""The layout of a simulated set: electrode nodes, touched places and force levels."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import laid_out
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.state_priors import force_N

POLAR = ("radii", "angles", "inner", "outer")  # keys of the touch grid of a disc
LATTICE = ("spacing_mm", "margin_mm")  # of an outline
MOST_PLACES = 1_000_000


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


def touch_grid(skin: Skin, probe_mm: float, **keys: Any) -> pd.DataFrame:
    """The places that are touched: place, x_mm, y_mm, radius_mm (half of `probe_mm`).

    keys: of a disc those of `polar_grid`, in units of its radius; of an outline spacing_mm and
    margin_mm of `RimCurve.lattice_within`. Raises InputError for keys of the other form, for
    missing ones, and for a lattice without a place or with more than MOST_PLACES.
    """
    rim = skin.rim
    check_form(keys, rim is not None)
    if rim is None:
        radius_mm = laid_out(skin).radius_mm
        assert radius_mm is not None
        return polar_grid(radius_mm, probe_mm=probe_mm, **keys)
    spacing_mm, margin_mm = keys["spacing_mm"], keys["margin_mm"]
    least_mm = float(np.sqrt(rim.area_mm2 / MOST_PLACES))
    if spacing_mm < least_mm:
        expected = f"{least_mm:.3g} or more: at most {MOST_PLACES} places on this skin"
        raise InputError("config", "touch_grid.spacing_mm", spacing_mm, expected)
    places = rim.lattice_within(spacing_mm, margin_mm)
    if not len(places):
        expected = "a margin within which the skin has a place of the lattice"
        raise InputError("config", "touch_grid.margin_mm", margin_mm, expected)
    return pd.DataFrame(
        {
            "place": np.arange(len(places)),
            "x_mm": places.real,
            "y_mm": places.imag,
            "radius_mm": 0.5 * probe_mm,
        }
    )


def check_form(keys: dict, has_outline: bool) -> None:
    """Raise InputError for a polar grid of a skin with an outline, for a lattice of a disc, and for
    a missing key of its own form."""
    required, others = (LATTICE, POLAR) if has_outline else (POLAR, LATTICE)
    expected = (
        "a lattice, spacing_mm and margin_mm, as the skin has an outline"
        if has_outline
        else "a polar grid, radii, angles, inner and outer, as the skin is a disc"
    )
    missing = [key for key in required if key not in keys]
    if missing:
        raise InputError("config", "touch_grid", f"no {missing[0]}", expected)
    for key in [key for key in keys if key in others]:
        raise InputError("config", f"touch_grid.{key}", keys[key], expected)


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
    grid = touch_grid(believed, **layout.touch_grid)
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
