"""Skins of many outlines with electrodes and touches, on which a solver is compared.

Twelve outlines have sixteen electrodes on the rim, spread evenly, as far from corners as that
allows; three have electrodes inside. Of every four touches two are in the middle, one is cut by the
rim, one lies on or near a corner.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from eitskin.physics.rim_curve import RimCurve
from witness import outlines
from witness.outline_skin import InnerElectrode, OutlineSkin, RimElectrode, Touch
from witness.outlines import Outline

ELECTRODES, WIDTH_MM, DIAMETER_MM = 16, 5.0, 8.0
IMPEDIVITY_OHM_M2 = 5e-4
CONDUCTIVITY_S_PER_M, THICKNESS_MM = 0.5, 3.0
BUILDERS = {
    "polygon": lambda p: outlines.polygon(p["corners_mm"]),
    "ellipse": lambda p: outlines.ellipse(*p["half_axes_mm"]),
    "spline": lambda p: outlines.spline(p["points_mm"]),
    "flat disc": lambda p: outlines.flat_disc(p["radius_mm"], p["flat_mm"]),
}


def _rectangle(x_mm: float, y_mm: float) -> dict[str, Any]:
    return _polygon([[0.0, 0.0], [x_mm, 0.0], [x_mm, y_mm], [0.0, y_mm]])


def _polygon(corners_mm: list[list[float]]) -> dict[str, Any]:
    return {"kind": "polygon", "corners_mm": corners_mm}


def _round(radii_mm: np.ndarray, turn: float = 0.0) -> list[list[float]]:
    """Points at radii on even angles."""
    angle = turn + 2.0 * np.pi * np.arange(len(radii_mm)) / len(radii_mm)
    return np.column_stack([radii_mm * np.cos(angle), radii_mm * np.sin(angle)]).round(6).tolist()


def _hand() -> list[list[float]]:
    """A palm 80 mm wide and 70 mm high, four fingers and a slanted thumb, each 3:1."""
    palm = [[0.0, 0.0], [80.0, 0.0]]
    out, across = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    low = np.array([80.0, 15.0])
    thumb = [low + 36.0 * out, low + 36.0 * out + 12.0 * across, low + np.array([0.0, 15.0])]
    corners = [*palm, low.tolist(), *(np.round(place, 6).tolist() for place in thumb)]
    for left in (64.0, 44.0, 24.0, 4.0):
        corners += [[left + 12.0, 70.0], [left + 12.0, 106.0], [left, 106.0], [left, 70.0]]
    corners.insert(6, [80.0, 70.0])
    return [*corners, [0.0, 70.0]]


def _blob() -> list[list[float]]:
    phi = 2.0 * np.pi * np.arange(40) / 40
    radii = np.full(40, 60.0)
    for share, lobes, turn in ((0.12, 2, 0.4), (0.08, 3, -1.0), (0.04, 5, 2.0)):
        radii += 60.0 * share * np.cos(lobes * phi + turn)
    return _round(radii)


_L_CORNERS = [[0.0, 0.0], [100.0, 0.0], [100.0, 50.0], [50.0, 50.0], [50.0, 100.0], [0.0, 100.0]]
_STAR_RADII = np.tile([70.0, 70.0 * (1.5 - 0.5 * 5.0**0.5)], 5)
# Definition of the outline; touches: x, y, radius in mm and contrast.
OUTLINES: dict[str, tuple[dict[str, Any], list[tuple[float, float, float, float]]]] = {
    "square": (
        _rectangle(100.0, 100.0),
        [(50, 50, 7.5, 2.0), (30, 60, 5, 1.0), (70, 98, 6, 1.5), (96, 95, 7.5, 0.5)],
    ),
    "rectangle 3:2": (
        _rectangle(120.0, 80.0),
        [(60, 40, 7.5, 2.0), (30, 60, 5, 1.0), (60, 78, 5, 1.5), (117, 77, 6, 0.5)],
    ),
    "rectangle 5:1": (
        _rectangle(200.0, 40.0),
        [(100, 20, 7.5, 2.0), (30, 25, 5, 1.0), (140, 38, 5, 1.5), (3, 4, 6, 0.5)],
    ),
    "rectangle 10:1": (
        _rectangle(200.0, 20.0),
        [(100, 10, 5, 2.0), (30, 12, 3, 1.0), (140, 18, 5, 1.5), (198, 10, 11, 0.5)],
    ),
    "L": (
        _polygon(_L_CORNERS),
        [(25, 25, 7.5, 2.0), (80, 20, 5, 1.0), (2, 60, 5, 1.5), (48, 47, 6, 0.5)],
    ),
    "hexagon": (
        {"kind": "polygon", "corners_mm": _round(np.full(6, 60.0))},
        [(0, 0, 7.5, 2.0), (-20, 25, 5, 1.0), (3, -50, 5, 1.5), (57, 1, 6, 0.5)],
    ),
    "star": (
        {"kind": "polygon", "corners_mm": _round(_STAR_RADII, 0.5 * np.pi)},
        [(0, 0, 7.5, 2.0), (5, 30, 5, 1.0), (-15, 22, 5, 1.5), (54, 19, 6, 0.5)],
    ),
    "hand": (
        _polygon(_hand()),
        [(40, 35, 7.5, 2.0), (50, 85, 4, 1.0), (2, 40, 5, 1.5), (30, 102, 8, 0.5)],
    ),
    "ellipse 2:1": (
        {"kind": "ellipse", "half_axes_mm": [80.0, 40.0]},
        [(0, 0, 7.5, 2.0), (30, 20, 5, 1.0), (0, 38, 5, 1.5), (77, 3, 6, 0.5)],
    ),
    "blob": (
        {"kind": "spline", "points_mm": _blob()},
        [(0, 0, 7.5, 2.0), (30, 20, 5, 1.0), (-55, 15, 6, 1.5), (10, -40, 5, 0.5)],
    ),
    "triangle": (
        _polygon([[0.0, 0.0], [120.0, 0.0], [35.0, 90.0]]),
        [(50, 30, 7.5, 2.0), (40, 60, 5, 1.0), (60, 2, 5, 1.5), (114, 3, 6, 0.5)],
    ),
    "flat disc": (
        {"kind": "flat disc", "radius_mm": 60.0, "flat_mm": 36.0},
        [(0, 0, 7.5, 2.0), (30, 20, 5, 1.0), (57, 10, 6, 1.5), (44, -33, 6, 0.5)],
    ),
}
# The outline, the number of electrodes on its rim, and the places of those inside, in mm.
INSIDE: dict[str, tuple[str, int, list[tuple[float, float]]]] = {
    "square, four inside": ("square", 12, [(25, 25), (75, 25), (72, 72), (25, 75)]),
    "ellipse, eight inside": (
        "ellipse 2:1",
        8,
        [(15, 0), (40, 0), (52, 18), (12, 22), (-15, 12), (-45, 8), (-40, -15), (10, -20)],
    ),
    "L, all inside": (
        "L",
        0,
        [
            *[(8.0 + 14.0 * k, 8.0) for k in range(7)],
            *[(8.0, 22.0 + 14.0 * k) for k in range(6)],
            *[(40.0, 40.0), (60.0, 40.0), (40.0, 70.0)],
        ],
    ),
}
NAMES = (*OUTLINES, *INSIDE)
# Those on which effects are concealed, and those of them whose rim has no corners.
CONCEALING = ("square", "rectangle 3:2", "L", "hexagon", "ellipse 2:1", "blob")
SMOOTH = ("ellipse 2:1", "blob")
DRAWN_POINTS = 400  # by which a rim without corners is stated


@dataclass(frozen=True)
class OutlineCase:
    """A skin for comparisons: `definition` holds its outline's kind and lengths in mm, as
    `BUILDERS` take them."""

    name: str
    definition: dict[str, Any]
    outline: Outline
    electrodes: tuple[RimElectrode | InnerElectrode, ...]
    touches: tuple[Touch, ...]

    def skin(self, **settings: Any) -> OutlineSkin:
        """The skin to be solved; settings: `OutlineSkin`'s fineness."""
        return OutlineSkin(
            self.outline, self.electrodes, CONDUCTIVITY_S_PER_M, THICKNESS_MM, **settings
        )


def sized_outline(name: str, radius_mm: float) -> tuple[Outline, RimCurve]:
    """One of `CONCEALING` with the area of a disc, the mean of its rim at the origin, lengths to
    0.01 mm; and as its owner states it. Raises KeyError for another."""
    definition, _ = OUTLINES[name]
    unsized = BUILDERS[definition["kind"]](definition)
    factor = radius_mm * np.sqrt(np.pi / unsized.area_mm2)
    middle = unsized.place(np.arange(DRAWN_POINTS) / DRAWN_POINTS).mean()
    sized = {"kind": definition["kind"]}
    for key in ("corners_mm", "points_mm"):
        if key in definition:
            places = np.array(definition[key]) - [middle.real, middle.imag]
            sized[key] = np.round(factor * places, 2).tolist()
    if "half_axes_mm" in definition:
        sized["half_axes_mm"] = np.round(factor * np.array(definition["half_axes_mm"]), 2).tolist()
    outline = BUILDERS[definition["kind"]](sized)
    if name not in SMOOTH:
        return outline, RimCurve(tuple(map(tuple, sized["corners_mm"])))
    points = outline.place(np.arange(DRAWN_POINTS) / DRAWN_POINTS)
    return outline, RimCurve(tuple(zip(points.real, points.imag, strict=True)), smooth=True)


def spread(outline: Outline, count: int, width_mm: float) -> np.ndarray:
    """(count,): even shares of the perimeter at which stretches of the rim are farthest from its
    corners."""
    even = np.arange(count) / max(count, 1)
    corners = outline.ends[outline.corners]
    offsets = (np.arange(200) + 0.5) / 200 / max(count, 1)
    if not len(corners) or not count:
        return even
    gap = np.abs((even[:, None] + offsets - corners[:, None, None] + 0.5) % 1.0 - 0.5)
    return even + offsets[gap.min(axis=(0, 1)).argmax()]


def outline_case(name: str) -> OutlineCase:
    """One of `NAMES`. Raises KeyError for another."""
    base, at_rim, inside = INSIDE.get(name, (name, ELECTRODES, []))
    definition, touches = OUTLINES[base]
    outline = BUILDERS[definition["kind"]](definition)
    shares = spread(outline, at_rim, WIDTH_MM)
    electrodes: tuple[RimElectrode | InnerElectrode, ...] = (
        *(RimElectrode(float(s), WIDTH_MM, IMPEDIVITY_OHM_M2) for s in shares),
        *(InnerElectrode(x, y, 0.5 * DIAMETER_MM, IMPEDIVITY_OHM_M2) for x, y in inside),
    )
    return OutlineCase(name, definition, outline, electrodes, tuple(Touch(*t) for t in touches))


def adjacent_channels(count: int = ELECTRODES) -> np.ndarray:
    """(count (count - 3), 4): source, sink, plus, minus of all adjacent pairs driven and read."""
    return np.array(
        [
            (k, (k + 1) % count, (k + j) % count, (k + j + 1) % count)
            for k in range(count)
            for j in range(2, count - 1)
        ]
    )
