"""Where a skin's rim and electrodes lie, to be drawn: of a disc or of any outline."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from eitskin import plotting
from eitskin.physics.geometry import even_angles
from eitskin.physics.outline import inside_mm, laid_out
from eitskin.physics.skin import Skin

RIM_POINTS = 360  # of a drawn curve


@dataclass(frozen=True)
class SkinLayout:
    """Complex places, x + i y, in mm: the rim (K,), closed, the electrodes' middles (n,) and unit
    normals there (n,), outwards; of electrodes inside, of which `inside` has the numbers, away from
    the centre. centre and half_extent_mm: of the smallest square about the rim.
    """

    rim: np.ndarray
    electrodes: np.ndarray
    outward: np.ndarray
    centre: complex
    half_extent_mm: float
    inside: np.ndarray

    def scaled(self, z: np.ndarray) -> np.ndarray:
        """Places z, mm, in half extents about the centre."""
        return (z - self.centre) / self.half_extent_mm


def layout(skin: Skin, n_electrodes: int, radius_mm: float) -> SkinLayout:
    """The layout of a skin; radius_mm: of a disc whose radius is not stated; electrodes at unknown
    angles are even. Raises InputError for an outline that `outline.refuse` refuses."""
    if skin.rim is not None:
        stated, rim = laid_out(skin), skin.rim
        phi = np.radians(np.array(stated.electrode_deg))
        curve = rim.place(rim.sampled_phi(1)[0]) if rim.smooth else rim.points
        closed = np.append(curve, curve[0])
        x, y = closed.real, closed.imag
        centre = complex(0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max()))
        half_extent = 0.5 * float(max(np.ptp(x), np.ptp(y)))
        return _with_inside(skin, closed, rim.place(phi), rim.normal(phi), centre, half_extent)
    stated_deg = (skin if inside_mm(skin) is None else laid_out(skin)).electrode_deg
    angles = even_angles(n_electrodes) if stated_deg is None else stated_deg
    radius = skin.radius_mm or radius_mm
    circle = radius * np.exp(2j * np.pi * np.arange(RIM_POINTS + 1) / RIM_POINTS)
    outward = np.exp(1j * np.radians(np.asarray(angles, float)))
    return _with_inside(skin, circle, radius * outward, outward, 0j, float(radius))


def _with_inside(
    skin: Skin,
    rim: np.ndarray,
    electrodes: np.ndarray,
    outward: np.ndarray,
    centre: complex,
    half_extent_mm: float,
) -> SkinLayout:
    """The layout with the electrodes inside where they are."""
    inner = inside_mm(skin)
    if inner is None:
        return SkinLayout(rim, electrodes, outward, centre, half_extent_mm, np.zeros(0, int))
    is_inside = ~np.isnan(inner)
    away = np.where(is_inside, inner - centre, 1.0)
    direction = np.where(np.abs(away) > 0.0, away / np.maximum(np.abs(away), 1e-300), 1.0)
    return SkinLayout(
        rim,
        np.where(is_inside, inner, electrodes),
        np.where(is_inside, direction, outward),
        centre,
        half_extent_mm,
        np.flatnonzero(is_inside),
    )


def stated_layout(skin: Skin) -> SkinLayout:
    """The layout of a skin whose size is stated, without electrodes where they are not. Raises
    InputError as `layout`."""
    stated = laid_out(skin)
    assert stated.radius_mm is not None
    return layout(skin, len(stated.electrode_deg or ()), stated.radius_mm)


def draw(axes: Axes, skin: Skin) -> SkinLayout:
    """Draw the rim and the electrodes of a skin whose places are all stated, in mm, with equal
    scales and room at which no electrode is cut; its layout. Raises InputError as `layout`."""
    placed = stated_layout(skin)
    if skin.rim is not None or len(placed.inside):
        plotting.outline(axes, placed.rim, placed.electrodes)
    else:
        plotting.disc(axes, placed.half_extent_mm, np.array(skin.electrode_deg))
    plotting.leave_room(axes, placed.half_extent_mm, placed.centre)
    return placed


def is_beyond(skin: Skin, z: np.ndarray) -> np.ndarray:
    """Whether complex places z, mm, lie off a skin whose size is stated."""
    if skin.rim is not None:
        return ~skin.rim.contains(z)
    radius_mm = laid_out(skin).radius_mm
    assert radius_mm is not None
    return np.abs(z) > radius_mm
