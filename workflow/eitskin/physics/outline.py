"""Outlines as the owner of a skin describes them, and electrodes on them.

Discs, and any rim that is given by its corners or as a smooth curve, are simulated, with electrodes
on the rim and inside; a shape that is only a word, and electrodes beyond the rim, are recognised
here and refused.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.skin import Skin
from eitskin.quantities import percent

DISCS = ("circle", "circular", "disc", "disk", "round")
# Largest deviation of a rim from a circle, and of an electrode from the rim, over the mean radius.
CIRCLE_TOLERANCE = 0.1
OFF_RIM_MM = 1.0  # of an electrode; one that is nearer to the rim of known size is put there
TOUCH_ROOM_MM = 0.5  # of a touch's edge from that of an electrode inside, in a diagnosis
SIDE_POINTS = 100  # points of each side at which its distance from the centre is evaluated
SQUARE_DEG = 3.0  # largest deviation of a rectangle's corners from a right angle
EXPECTED = (
    'a disc, or skin.outline as {"shape": …} or {"corners_mm": …}, with its electrodes on the rim '
    "or inside; without a simulation, `eitskin check` and `eitskin compare CONTROL LATER` work all "
    "the same"
)


def refuse(skin: Skin, file: str | Path = "skin") -> None:
    """Raise InputError, with `file` as its place, for a skin that cannot be simulated."""
    refusal = not_simulated(skin)
    if refusal is not None:
        place, actual = refusal
        raise InputError(file, place, actual, EXPECTED)


def not_simulated(skin: Skin) -> tuple[str, str] | None:
    """The key of a skin's metadata that rules out its simulation, and a description; None: it can
    be simulated."""
    shape = skin.outline
    if isinstance(shape, str):
        return None if shape.strip().lower() in DISCS else ("skin.outline", shape)
    if isinstance(shape, RimCurve):
        return _off_outline(skin, shape)
    if shape is not None:
        description = described(np.array(shape), " mm")
        if description is not None:
            return "skin.outline", f"{description}, as a bare list"
    if skin.electrode_xy_mm is None:
        return None
    electrodes, inner = np.array(skin.electrode_xy_mm), inside_mm(skin)
    radius = skin.radius_mm or float(np.hypot(*electrodes.T).max())
    if inner is not None:
        electrodes[~np.isnan(inner)] = radius, 0.0
    electrodes_text = off_rim(electrodes, radius)
    return None if electrodes_text is None else ("skin.electrode_xy_mm", electrodes_text)


def _off_outline(skin: Skin, rim: RimCurve) -> tuple[str, str] | None:
    if _is_laid_out(skin, rim):
        return None
    if skin.radius_mm is not None:
        return "skin.radius_mm", f"{skin.radius_mm:g} mm beside an outline"
    if skin.electrode_s is not None:
        return None
    if skin.electrode_xy_mm is None:
        return "skin.electrode_xy_mm", "nothing, nor electrode_s, beside an outline"
    place = _complex(np.array(skin.electrode_xy_mm))
    _, distance = rim.nearest(place)
    off = np.flatnonzero((distance > OFF_RIM_MM) & ~rim.contains(place))
    if not len(off):
        return None
    return "skin.electrode_xy_mm", f"electrode {off[0]} {distance[off[0]]:.3g} mm beyond the rim"


def _is_laid_out(skin: Skin, rim: RimCurve) -> bool:
    radius = rim.perimeter_mm / (2.0 * np.pi)
    return skin.radius_mm == radius and skin.electrode_deg is not None


def laid_out(skin: Skin) -> Skin:
    """A skin with an outline as the simulation takes it: `radius_mm` the rim's length over 2 pi,
    `electrode_deg` the electrodes' shares of it in degrees. Any other is returned as a disc.
    `electrode_xy_mm` remains where electrodes are inside, and says where these are; then the angles
    of a disc are those of the places, unless stated.

    Raises InputError as `refuse`.
    """
    refuse(skin)
    rim = skin.rim
    electrode_xy_mm = None if inside_mm(skin) is None else skin.electrode_xy_mm
    if rim is None:
        angles = skin.electrode_deg
        if electrode_xy_mm is not None and angles is None:
            angles = tuple(rim_angles(np.array(electrode_xy_mm)).tolist())
        return replace(
            skin,
            outline=None,
            electrode_deg=angles,
            electrode_xy_mm=electrode_xy_mm,
            electrode_s=None,
        )
    if _is_laid_out(skin, rim):
        return skin
    if skin.electrode_s is not None:
        share = np.array(skin.electrode_s)
    else:
        share = rim.nearest(_complex(np.array(skin.electrode_xy_mm)))[0] / (2.0 * np.pi)
    return replace(
        skin,
        radius_mm=rim.perimeter_mm / (2.0 * np.pi),
        electrode_deg=tuple((360.0 * share).tolist()),
        electrode_xy_mm=electrode_xy_mm,
        electrode_s=None,
    )


def inside_mm(skin: Skin) -> np.ndarray | None:
    """(n,) complex, mm: places of the electrodes inside a skin, NaN of those on its rim; None where
    there are none, and of a disc of unknown radius."""
    if skin.electrode_xy_mm is None or skin.electrode_s is not None:
        return None
    place = _complex(np.array(skin.electrode_xy_mm))
    if skin.rim is not None:
        inside = skin.rim.contains(place) & (skin.rim.nearest(place)[1] > OFF_RIM_MM)
    elif skin.radius_mm is not None:
        inside = np.abs(place) < skin.radius_mm - OFF_RIM_MM
    else:
        return None
    return np.where(inside, place, np.nan) if inside.any() else None


def is_touchable(skin: Skin, centre: np.ndarray, radius_mm: np.ndarray) -> np.ndarray:
    """(N,) bool: whether touches, complex centres and radii (N,) in mm, stay TOUCH_ROOM_MM off the
    edges of the electrodes inside a skin, and cover none where the rim cuts them."""
    inner = inside_mm(skin)
    if inner is None:
        return np.ones(len(centre), bool)
    offset = np.abs(centre[:, None] - inner[~np.isnan(inner)])
    half = 0.5 * (skin.electrode_width_mm or 0.0)
    crosses = np.abs(offset - radius_mm[:, None]) < half + TOUCH_ROOM_MM
    if skin.rim is not None:
        depth = skin.rim.depth(centre)
    else:
        assert skin.radius_mm is not None
        depth = skin.radius_mm - np.abs(centre)
    covers = (offset < radius_mm[:, None]).any(axis=1)
    return ~crosses.any(axis=1) & ~(covers & (depth < radius_mm))


def rim_numbers(skin: Skin, n_electrodes: int) -> np.ndarray:
    """Numbers of those of n electrodes that are on the rim."""
    inner = inside_mm(skin)
    return np.arange(n_electrodes) if inner is None else np.flatnonzero(np.isnan(inner))


def is_plain_disc(skin: Skin) -> bool:
    """Whether a skin is a disc whose electrodes are all on its rim."""
    return skin.rim is None and inside_mm(skin) is None


def as_stated(skin: Skin) -> Skin:
    """A skin that is `laid_out` as its owner would state it: on an outline by `electrode_s`, or by
    `electrode_xy_mm` where electrodes are inside."""
    if skin.rim is None or skin.electrode_deg is None:
        return skin
    inner = inside_mm(skin)
    if inner is not None:
        on_rim = skin.rim.place(np.radians(skin.electrode_deg))
        place = np.where(np.isnan(inner), on_rim, inner)
        xy_mm = tuple(zip(place.real.tolist(), place.imag.tolist(), strict=True))
        return replace(skin, radius_mm=None, electrode_deg=None, electrode_xy_mm=xy_mm)
    share = np.array(skin.electrode_deg) / 360.0 % 1.0
    return replace(skin, radius_mm=None, electrode_deg=None, electrode_s=tuple(share.tolist()))


def rim_angles(electrodes: np.ndarray) -> np.ndarray:
    """(n,) degrees, 0 to 360, at which electrodes at (n, 2) lie about the centre."""
    return np.degrees(np.angle(_complex(np.asarray(electrodes, float)))) % 360.0


def described(corners: np.ndarray, unit: str = "") -> str | None:
    """A description of an outline with corners (K, 2), in order round it; None for one within
    CIRCLE_TOLERANCE of a circle about its centre. `unit` is appended to lengths."""
    corner_points = _complex(corners)
    centre, radius = ring(corners)
    deviation = (
        float(np.abs(np.abs(_sides(corner_points) - centre) / radius - 1.0).max())
        if radius
        else np.inf
    )
    if deviation <= CIRCLE_TOLERANCE:
        return None
    side = np.roll(corner_points, -1) - corner_points
    turn = np.degrees(np.angle(side * np.roll(side, 1).conj()))
    if len(corner_points) == 4 and side.all() and np.allclose(np.abs(turn), 90.0, atol=SQUARE_DEG):
        return f"a rectangle of {abs(side[0]):.4g} x {abs(side[1]):.4g}{unit}"
    across, up = np.ptp(corners, axis=0)
    return (
        f"an outline of {len(corner_points)} corners, {across:.4g} x {up:.4g}{unit}, "
        f"up to {percent(deviation)} of its mean radius off a circle"
    )


def off_rim(electrodes: np.ndarray, radius: float) -> str | None:
    """A description of electrodes at (n, 2) that lie off a rim of this radius about 0; None for
    none."""
    share = np.hypot(*electrodes.T) / radius
    off_rim_electrodes = np.flatnonzero(np.abs(share - 1.0) > CIRCLE_TOLERANCE)
    if not len(off_rim_electrodes):
        return None
    electrode = int(off_rim_electrodes[0])
    remainder = f" and {len(off_rim_electrodes) - 1} more" if len(off_rim_electrodes) > 1 else ""
    return (
        f"electrode {electrode}{remainder} of {len(electrodes)} off the rim, at "
        f"{percent(share[electrode])} of the radius from the centre"
    )


def ring(corners: np.ndarray) -> tuple[complex, float]:
    """Centroid x + i y of the area within an outline with corners (K, 2), and the outline's mean
    distance from it; the distance is 0 for an outline without area."""
    corner_points = _complex(corners)
    relative = corner_points - corner_points[0]
    next_corner = np.roll(relative, -1)
    double_area = (relative.conj() * next_corner).imag
    if not double_area.sum():
        return complex(corner_points[0]), 0.0
    centre = complex(
        corner_points[0]
        + ((relative + next_corner) * double_area).sum() / (3.0 * double_area.sum())
    )
    length = np.repeat(np.abs(next_corner - relative), SIDE_POINTS)
    return centre, float(np.average(np.abs(_sides(corner_points) - centre), weights=length))


def _sides(corners: np.ndarray) -> np.ndarray:
    """(K ALONG,): points evenly along the sides between complex corners (K,)."""
    share = np.arange(SIDE_POINTS) / SIDE_POINTS
    return (corners[:, None] + share * (np.roll(corners, -1) - corners)[:, None]).ravel()


def _complex(xy: np.ndarray) -> np.ndarray:
    return xy[:, 0] + 1j * xy[:, 1]
