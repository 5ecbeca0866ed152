"""Outlines that are no disc, and electrodes off the rim, as the owner of a skin describes them.

The simulation knows discs, and rims near a disc (effect domain-shape): what a description says that
is neither is told apart here, and refused where something is to be simulated.
"""

from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.skin import Skin
from eitskin.quantities import percent

DISCS = ("circle", "circular", "disc", "disk", "round")
NEAR = 0.1  # of the mean radius, by which a rim may be off a circle, and an electrode off the rim
ALONG = 100  # points of each side, at which its distance from the centre is looked at
SQUARE_DEG = 3.0  # by which the corners of a rectangle may be off a right angle
EXPECTED = (
    "a disc with its electrodes on the rim, which the simulation knows, or a rim within "
    f"{percent(NEAR)} of one (effect domain-shape); without a simulation, `eitskin check` and "
    "`eitskin compare CONTROL LATER` work all the same"
)


def refuse(skin: Skin, file: str | Path = "skin") -> None:
    """Raise InputError, with `file` as its place, for a skin that is no disc with electrodes on its
    rim."""
    other = no_disc(skin)
    if other is not None:
        place, found = other
        raise InputError(file, place, found, EXPECTED)


def no_disc(skin: Skin) -> tuple[str, str] | None:
    """Which key of a skin says that it is no disc with electrodes on its rim, and what it is
    instead; None where none does."""
    corners = skin.outline
    if isinstance(corners, str):
        return None if corners.strip().lower() in DISCS else ("skin.outline", corners)
    if corners is not None:
        shape = described(np.array(corners), " mm")
        if shape is not None:
            return "skin.outline", shape
    if skin.electrode_xy_mm is None:
        return None
    radius = skin.radius_mm or float(np.hypot(*np.array(skin.electrode_xy_mm).T).max())
    off = off_rim(np.array(skin.electrode_xy_mm), radius)
    return None if off is None else ("skin.electrode_xy_mm", off)


def rim_angles(electrodes: np.ndarray) -> np.ndarray:
    """(n,) degrees, 0 to 360, at which electrodes at (n, 2) lie about the centre."""
    return np.degrees(np.angle(_complex(np.asarray(electrodes, float)))) % 360.0


def described(corners: np.ndarray, unit: str = "") -> str | None:
    """What an outline with corners (K, 2), one after the other, is; None where it is within NEAR of
    a circle about its centre. Lengths are in `unit`."""
    at = _complex(corners)
    centre, radius = ring(corners)
    off = float(np.abs(np.abs(_sides(at) - centre) / radius - 1.0).max()) if radius else np.inf
    if off <= NEAR:
        return None
    side = np.roll(at, -1) - at
    turn = np.degrees(np.angle(side * np.roll(side, 1).conj()))
    if len(at) == 4 and side.all() and np.allclose(np.abs(turn), 90.0, atol=SQUARE_DEG):
        return f"a rectangle of {abs(side[0]):.4g} x {abs(side[1]):.4g}{unit}"
    across, up = np.ptp(corners, axis=0)
    return (
        f"an outline of {len(at)} corners, {across:.4g} x {up:.4g}{unit}, "
        f"up to {percent(off)} of its mean radius off a circle"
    )


def off_rim(electrodes: np.ndarray, radius: float) -> str | None:
    """What is said of electrodes at (n, 2) off a rim about 0; None where none is."""
    share = np.hypot(*electrodes.T) / radius
    off = np.flatnonzero(np.abs(share - 1.0) > NEAR)
    if not len(off):
        return None
    first = int(off[0])
    others = f" and {len(off) - 1} more" if len(off) > 1 else ""
    return (
        f"electrode {first}{others} of {len(electrodes)} off the rim, at {percent(share[first])} "
        "of the radius from the centre"
    )


def ring(corners: np.ndarray) -> tuple[complex, float]:
    """The centroid x + i y of the area in an outline with corners (K, 2), and the outline's mean
    distance from there; 0 where there is no area."""
    at = _complex(corners)
    here = at - at[0]
    following = np.roll(here, -1)
    twice = (here.conj() * following).imag
    if not twice.sum():
        return complex(at[0]), 0.0
    centre = complex(at[0] + ((here + following) * twice).sum() / (3.0 * twice.sum()))
    length = np.repeat(np.abs(following - here), ALONG)
    return centre, float(np.average(np.abs(_sides(at) - centre), weights=length))


def _sides(corners: np.ndarray) -> np.ndarray:
    """(K ALONG,): points evenly along the sides between complex corners (K,)."""
    share = np.arange(ALONG) / ALONG
    return (corners[:, None] + share * (np.roll(corners, -1) - corners)[:, None]).ravel()


def _complex(xy: np.ndarray) -> np.ndarray:
    return xy[:, 0] + 1j * xy[:, 1]
