"""The skin that a drawing shows: which of its curves is the rim, which are electrodes."""

from dataclasses import fields
from itertools import pairwise
from pathlib import Path

import numpy as np

from eitskin.drawing.curves import Curve, Drawing, joined
from eitskin.errors import InputError
from eitskin.physics.geometry import CORNER_CLEARANCE
from eitskin.physics.outline import OFF_RIM_MM
from eitskin.physics.rim_curve import MOST_CORNERS, SHARP_DEG, RimCurve, distance, inside
from eitskin.physics.skin import Skin
from eitskin.quantities import listed

SMALL_SHARE = 0.2  # of the largest shape: a mark is smaller
ROUND_SHARE = 5e-4  # of its radius, which a drawn circle or ellipse may leave
EVEN_SHARE = 1e-5  # of the extent: corners nearer to a straight side lie on it
CURVE_SHARE = 2e-4  # of the extent, which a smooth rim may leave the drawn one
CLEAR_SIZES = 0.75  # of a drawn electrode's size, within which a bent side gets no corner
CLEAR_SHARE = 0.01  # of the extent, at least
CLEAR_SPACING = 0.3  # of the distance to the next electrode, at most
STRAIGHT_SHARE = 1e-9  # of a side's length, by which it is longer than its ends are apart
LEAST_STEPS = 8  # of a bent side
DENSE_POINTS = 2880  # of a drawn rim, evenly, to compare with
SMOOTH_POINTS = (90, 180, 360, 720)  # of a curve: the fewest that follow the drawn one
COARSER = 1.3  # from a tolerance to the next, until few enough corners are left
SAME_MM = 1e-3  # between places that are one
TOLD_MM = 0.05  # by which an electrode is put elsewhere, that a sentence says so
DECIMALS = 4  # of mm, and of degrees
RIM_NAMED = "one closed path, or several with the rim's id, class or layer 'rim'"


def skin_block(
    drawing: Drawing, unit_mm: float | None, mirrored: bool, file: str | Path
) -> tuple[dict, list[str]]:
    """Keys of the recording format's `skin` that a drawing says, and sentences on what was made of
    it. unit_mm: of a drawing's unit, in place of the file's own; mirrored: it shows the side that
    is not touched.

    The origin is the middle of the box around the rim. Raises InputError, which names `file` and
    the shape, for a drawing without unit, without a closed path or with several that may be the
    rim, for a rim that crosses itself, and for electrodes off the rim or at one place.
    """
    factor = drawing.unit_mm if unit_mm is None else unit_mm
    if not drawing.curves:
        raise InputError(file, "shapes", "none", "a closed path, the skin's rim")
    if factor is None:
        expected = "--unit mm, --unit in or --unit px:0.2646, what a unit of the drawing is"
        raise InputError(file, "unit", "none in the file", expected)
    rim, marks, sentences = _rim_and_marks(
        [curve.scaled(factor, mirrored) for curve in drawing.curves], file
    )
    origin = rim.middle
    loop = rim.shifted(-origin)
    if _double_area(loop.points) < 0:
        loop = loop.backwards()
    marks = [mark.shifted(-origin) for mark in marks]
    outline, words = _outline(loop, marks, file)
    sentences += words
    places, words = _places(marks, outline, file)
    sentences += words
    if isinstance(outline, float):
        deg = np.round(np.degrees(np.angle(places)) % 360.0, DECIMALS) % 360.0
        block = {"radius_mm": round(outline, DECIMALS), "electrode_deg": deg.tolist()}
    else:
        block = {"radius_mm": None, "outline": outline, "electrode_deg": None}
        block["electrode_xy_mm"] = _listed(places)
    x, y = np.round([-origin.real if mirrored else origin.real, origin.imag], 3) + 0.0
    sentences.append(
        f"The origin is the middle of the box around the rim, ({x:g}, {y:g}) mm of the drawing"
        " with y upwards."
    )
    return block, sentences


def _rim_and_marks(curves: list[Curve], file: str | Path) -> tuple[Curve, list[Curve], list[str]]:
    """The rim, the electrodes in order, and sentences on what is neither."""
    chains = joined([curve for curve in curves if not curve.is_electrode])
    loops = [chain for chain in chains if chain.closed]
    if not loops:
        raise _open(chains, file)
    candidates = [loop for loop in loops if loop.is_rim] or loops
    rim = max(candidates, key=_size)
    small = SMALL_SHARE * _size(rim)
    rivals = [loop for loop in candidates if _size(loop) >= small]
    if len(rivals) > 1:
        described = ", ".join(map(_described, rivals))
        raise InputError(file, "rim", f"{len(rivals)} closed paths: {described}", RIM_NAMED)
    marks = joined([curve for curve in curves if curve.is_electrode])
    if not marks:
        marks = [loop for loop in loops if loop is not rim and _size(loop) < small]
    if not marks:
        expected = "small closed shapes, or a group, class or layer named 'electrodes'"
        raise InputError(file, "electrodes", "none", expected)
    ignored = len([chain for chain in chains if chain is not rim and chain not in marks])
    sentences = [f"The rim is {_described(rim)}."]
    if ignored:
        things = "1 other shape is" if ignored == 1 else f"{ignored} other shapes are"
        sentences.append(f"{things} left out, being neither rim nor electrode.")
    return rim, marks, sentences


def _open(strands: list[Curve], file: str | Path) -> InputError:
    """What is wrong with a drawing without a closed path."""
    if not strands:
        return InputError(file, "rim", "electrodes alone", RIM_NAMED)
    longest = max(strands, key=_size)
    ends = " and ".join(f"({z.real:.4g}, {z.imag:.4g})" for z in longest.points[[0, -1]])
    actual = f"an open path, {longest.gap:.3g} mm between its ends {ends} mm, y upwards"
    return InputError(file, longest.place, actual, "a closed path, the skin's rim")


def _size(loop: Curve) -> float:
    return float(loop.extent.max())


def _described(loop: Curve) -> str:
    width, height = loop.extent
    return f"{loop.place}, {width:.4g} x {height:.4g} mm"


def _outline(loop: Curve, marks: list[Curve], file: str | Path) -> tuple[float | dict, list[str]]:
    """A disc's radius in mm or the object of another outline, of a counter-clockwise loop about
    0, and sentences on what it leaves of the drawn one. Corners that stand for a bent side are off
    the electrodes."""
    points, extent = loop.points, _size(loop)
    half = 0.5 * loop.extent
    dense = _even(points, DENSE_POINTS)
    if _is_ellipse(dense, half):
        if abs(half[0] - half[1]) <= ROUND_SHARE * half.max():
            return float(half.mean()), []
        return {"shape": "ellipse"} | _box(loop), []
    corners = _without_straight(points[:-1], EVEN_SHARE * extent)
    if loop.straight and len(corners) <= MOST_CORNERS:
        rim = _rim(corners, False, loop, file)
        is_box = len(corners) == 4 and np.allclose(
            np.abs(np.stack([corners.real, corners.imag])), half[:, None], atol=EVEN_SHARE * extent
        )
        return ({"shape": "rectangle"} | _box(loop) if is_box else _object(rim)), []
    drawn_corners = np.flatnonzero(_turns_deg(points[:-1]) >= SHARP_DEG)
    if len(drawn_corners) <= MOST_CORNERS:
        for count in SMOOTH_POINTS:
            rim = _rim(_along(points, drawn_corners, count), True, loop, file)
            left = float(rim.nearest(dense)[1].max())
            followed = left <= CURVE_SHARE * extent
            if followed and len(rim.corner_points) == len(drawn_corners):
                return _object(rim), _bent_sentences(rim, left)
    candidates = points[:-1][_off_electrodes(points[:-1], marks, extent)]
    tolerance = CURVE_SHARE * extent
    while len(corners := _without_straight(candidates, tolerance)) > MOST_CORNERS:
        tolerance *= COARSER
    rim = _rim(corners, False, loop, file)
    left = float(distance(corners, dense).max())
    sentence = f"No curve follows it: {len(corners)} corners stand for it, up to "
    return _object(rim), [f"{sentence}{left:.2g} mm off what is drawn."]


def _bent_sentences(rim: RimCurve, left_mm: float) -> list[str]:
    """A sentence on the corners of a drawn rim, and what it leaves of the drawn one."""
    if not len(rim.corner_points):
        return []
    corners = rim.points[rim.corner_points]
    places = listed([f"({z.real:.4g}, {z.imag:.4g})" for z in corners])
    sentence = f"It is bent, with corners at {places} mm about the origin, and the curve is up to "
    return [f"{sentence}{left_mm:.2g} mm off what is drawn."]


def _rim(points: np.ndarray, smooth: bool, loop: Curve, file: str | Path) -> RimCurve:
    """The curve through points (K,). Raises InputError where these are none."""
    try:
        return RimCurve(tuple((x, y) for x, y in _listed(points)), smooth)
    except InputError as error:
        actual = error.actual
        if "that meet" in actual:
            actual = f"a path that crosses itself: {actual}"
        raise InputError(file, loop.place, actual, error.expected) from error


def _object(rim: RimCurve) -> dict:
    corners = {"corners_mm": [list(point) for point in rim.points_mm]}
    return corners | ({"smooth": True} if rim.smooth else {})


def _box(loop: Curve) -> dict:
    width, height = np.round(loop.extent, DECIMALS).tolist()
    return {"width_mm": width, "height_mm": height}


def _listed(places: np.ndarray) -> list[list[float]]:
    return (np.round(np.stack([places.real, places.imag], axis=-1), DECIMALS) + 0.0).tolist()


def _double_area(points: np.ndarray) -> float:
    return float((np.conj(points) * np.roll(points, -1)).imag.sum())


def _even(points: np.ndarray, count: int) -> np.ndarray:
    """(count,): points evenly along a closed polyline (K,) whose last point is its first."""
    length = np.append(0.0, np.cumsum(np.abs(np.diff(points))))
    share = length[-1] * np.arange(count) / count
    return np.interp(share, length, points.real) + 1j * np.interp(share, length, points.imag)


def _along(points: np.ndarray, corners: np.ndarray, count: int) -> np.ndarray:
    """About `count` points evenly along a closed polyline (K,) whose last point is its first; from
    its first corner on where it has any, of straight sides the corners alone."""
    if not len(corners):
        return _even(points, count)
    loop = np.roll(points[:-1], -corners[0])
    loop = np.append(loop, loop[0])
    ends = np.append(corners - corners[0], len(loop) - 1)
    spacing = np.abs(np.diff(loop)).sum() / count
    parts = []
    for start, stop in pairwise(ends):
        side = loop[start : stop + 1]
        length = np.append(0.0, np.cumsum(np.abs(np.diff(side))))
        straight = length[-1] - abs(side[-1] - side[0]) <= STRAIGHT_SHARE * length[-1]
        steps = 1 if straight else max(int(length[-1] / spacing), LEAST_STEPS)
        share = length[-1] * np.arange(steps) / steps
        parts.append(np.interp(share, length, side.real) + 1j * np.interp(share, length, side.imag))
    return np.concatenate(parts)


def _is_ellipse(dense: np.ndarray, half: np.ndarray) -> bool:
    """Whether points lie on an ellipse with half axes along x and y about 0."""
    level = np.hypot(dense.real / half[0], dense.imag / half[1])
    return bool(np.abs(level - 1.0).max() <= ROUND_SHARE)


def _turns_deg(points: np.ndarray) -> np.ndarray:
    """(K,): by how much a closed polygon (K,) turns at each point, either way."""
    steps = np.roll(points, -1) - points
    return np.degrees(np.abs(np.angle(steps * np.roll(steps, 1).conj())))


def _off_electrodes(points: np.ndarray, marks: list[Curve], extent: float) -> np.ndarray:
    """(K,): whether points of a rim are corners of it, or off the electrodes that are drawn."""
    middles = np.array([mark.middle for mark in marks])
    spacing = np.abs(middles - middles[:, None]) + np.diag(np.full(len(middles), extent))
    sizes = np.array([max(CLEAR_SIZES * _size(mark), CLEAR_SHARE * extent) for mark in marks])
    clearance = np.minimum(sizes, CLEAR_SPACING * spacing.min(axis=1))
    clear = (np.abs(points[:, None] - middles) > clearance).all(axis=1)
    return clear | (_turns_deg(points) >= SHARP_DEG)


def _without_straight(corners: np.ndarray, tolerance: float) -> np.ndarray:
    """The fewest of the corners (K,), in order, whose polygon leaves none of them by more than the
    tolerance, as Douglas and Peucker thin a line (1973, Cartographica 10:112)."""
    far = int(np.abs(corners - corners[0]).argmax())
    closed = np.append(corners, corners[0])
    stays = {0, far}
    waiting = [(0, far), (far, len(corners))]
    while waiting:
        start, stop = waiting.pop()
        between = closed[start + 1 : stop]
        if not len(between):
            continue
        away = distance(closed[[start, stop]], between)
        if away.max() > tolerance:
            middle = start + 1 + int(away.argmax())
            stays.add(middle)
            waiting += [(start, middle), (middle, stop)]
    thinned = corners[sorted(stays)]
    is_spare = len(thinned) > 3 and distance(thinned[[-1, 1]], thinned[:1])[0] <= tolerance
    return thinned[1:] if is_spare else thinned


def _places(
    marks: list[Curve], outline: float | dict, file: str | Path
) -> tuple[np.ndarray, list[str]]:
    """(n,) places of the electrodes on the rim, mm, and a sentence on those that were moved there.

    Raises InputError for one off the rim, and for two at one place.
    """
    skin = Skin.from_metadata(
        dict.fromkeys(field.name for field in fields(Skin))
        | ({} if isinstance(outline, float) else {"outline": outline})
    )
    rim = skin.outline
    middles = np.array([mark.middle for mark in marks])
    if isinstance(rim, RimCurve):
        phi, away = rim.nearest(middles)
        places, polygon = rim.place(phi), rim.place(rim.sampled_phi(1)[0])
    else:
        assert isinstance(outline, float)
        places, away = outline * np.exp(1j * np.angle(middles)), np.abs(np.abs(middles) - outline)
        polygon = outline * np.exp(2j * np.pi * np.arange(DENSE_POINTS) / DENSE_POINTS)
    for k, mark in enumerate(marks):
        within = inside(polygon, mark.points)
        reaches = within.any() and not within.all()
        if not reaches and distance(polygon, mark.points).min() > OFF_RIM_MM:
            where = f"({middles[k].real:.4g}, {middles[k].imag:.4g}) mm from its middle"
            actual = f"electrode {k} {away[k]:.3g} mm off the rim, at {where}"
            expected = f"electrodes that touch the rim or come within {OFF_RIM_MM:g} mm of it"
            raise InputError(file, mark.place, actual, expected)
    spacing = np.abs(places - places[:, None]) + np.diag(np.full(len(places), np.inf))
    if len(places) > 1 and spacing.min() < SAME_MM:
        first, second = np.unravel_index(spacing.argmin(), spacing.shape)
        actual = f"electrodes {first} and {second} at one place"
        raise InputError(file, marks[second].place, actual, "each at a place of its own")
    sentences = _corner_sentences(phi, rim) if isinstance(rim, RimCurve) else []
    k = int(away.argmax())
    if away[k] > TOLD_MM:
        sentences.append(
            f"Electrodes stand at the nearest place of the rim: electrode {k} moves most, by "
            f"{away[k]:.3g} mm."
        )
    return places, sentences


def _corner_sentences(phi: np.ndarray, rim: RimCurve) -> list[str]:
    """A sentence on electrodes, at angles (n,), that are not simulated as points."""
    offset = phi[:, None] - rim.corner_phi
    offset = np.abs((offset + np.pi) % (2.0 * np.pi) - np.pi)
    at_corner = np.flatnonzero((offset < CORNER_CLEARANCE).any(axis=1))
    if not len(at_corner):
        return []
    numbers = listed(at_corner.tolist())
    return [f"At a corner, where they need a width to be simulated: electrodes {numbers}."]
