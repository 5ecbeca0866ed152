"""The properties of a skin as its owner states them: the recording's `skin` metadata."""

from dataclasses import dataclass, fields
from typing import Any, TypeGuard

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.rim_curve import RimCurve
from eitskin.yaml_number import hint

OPTIONAL = ("electrode_height_mm", "electrode_z_mm", "outline", "electrode_xy_mm", "electrode_s")
ELECTRODE_PLACES = ("electrode_deg", "electrode_s", "electrode_xy_mm")  # any one of them will do
SHAPES = ("rectangle", "ellipse")
ELLIPSE_POINTS = 720  # through which the smooth rim of an ellipse goes
POSITIVE = (
    "radius_mm",
    "thickness_mm",
    "conductivity_S_per_m",
    "current_A",
    "electrode_height_mm",
    "electrode_z_mm",
)
NOT_NEGATIVE = ("electrode_width_mm", "contact_impedivity_ohm_m2")
LARGEST = 1e50  # of any number: products of six are finite; no quantity of a skin comes near
MAX_ELECTRODES = 1024  # no EIT device has more
ONE_EACH = f"one an electrode, at most {MAX_ELECTRODES}"


@dataclass(frozen=True)
class Skin:
    """A sheet of gel with electrodes on its rim or inside; None: unknown, to be calibrated.

    Units stand in the names; `electrode_width_mm` is an arc length, of an electrode inside the
    diameter, 0 for point electrodes.
    outline: of a skin that is no disc, its rim, a word for its shape, or the corners (x, y) in mm
    of one that may be a disc all the same; electrode_xy_mm: (x, y) of every electrode; electrode_s:
    its share of the rim's length from the first corner, counter-clockwise.
    """

    radius_mm: float | None
    thickness_mm: float | None
    conductivity_S_per_m: float | None
    electrode_deg: tuple[float, ...] | None
    electrode_width_mm: float | None
    contact_impedivity_ohm_m2: float | None
    current_A: float | None
    contrast_per_N: float | None
    electrode_height_mm: float | None = None
    electrode_z_mm: float | None = None
    outline: RimCurve | str | tuple[tuple[float, float], ...] | None = None
    electrode_xy_mm: tuple[tuple[float, float], ...] | None = None
    electrode_s: tuple[float, ...] | None = None

    @property
    def rim(self) -> RimCurve | None:
        """The rim of a skin that is stated to be no disc; None for any other."""
        return self.outline if isinstance(self.outline, RimCurve) else None

    @classmethod
    def from_metadata(cls, metadata: dict, file: str = "skin") -> "Skin":
        """Read the `skin` object; raises InputError naming the key."""
        if not isinstance(metadata, dict):
            raise InputError(file, "skin", repr(metadata), "an object")
        keys = [field.name for field in fields(cls)]
        for key in metadata:
            if key not in keys:
                raise InputError(file, f"skin.{key}", "an unknown key", f"one of {keys}")
        values: dict = {}
        for key in keys:
            if key not in metadata:
                if key not in OPTIONAL:
                    raise InputError(file, f"skin.{key}", "nothing", "a number or null")
                continue
            value = metadata[key]
            if key == "electrode_deg" and value is not None:
                if not isinstance(value, list | tuple) or not all(map(is_number, value)):
                    raise InputError(
                        file, f"skin.{key}", repr(value), f"a list of angles{hint(value)}"
                    )
                if not value:
                    raise InputError(file, f"skin.{key}", "no angle", "one an electrode, or null")
                if len(value) > MAX_ELECTRODES:
                    raise InputError(file, f"skin.{key}", f"{len(value)} angles", ONE_EACH)
                if len({round(angle % 360.0, 9) for angle in value}) < len(value):
                    raise InputError(file, f"skin.{key}", "two equal angles", "one an electrode")
                value = tuple(float(angle) for angle in value)
            elif key == "outline" and isinstance(value, dict):
                value = _checked_rim(file, value)
            elif key in ("outline", "electrode_xy_mm") and value is not None:
                value = _checked_shape(file, key, value)
            elif key == "electrode_s" and value is not None:
                value = _checked_shares(file, value)
            elif value is not None:
                value = _checked_number(file, key, value)
            values[key] = value
        return cls(**values)

    def metadata(self) -> dict:
        """The recording format's `skin` object; optional keys only where given."""
        values = {f.name: _listed(getattr(self, f.name)) for f in fields(self)}
        return {k: v for k, v in values.items() if k not in OPTIONAL or v is not None}


def _checked_rim(file: str, value: dict) -> RimCurve:
    """The rim of an outline's object."""
    place = "skin.outline"
    if "shape" in value:
        shape, width, height = (value.get(key) for key in ("shape", "width_mm", "height_mm"))
        is_length = all(is_number(length) and length > 0 for length in (width, height))
        if shape not in SHAPES or not is_length or len(value) != 3:
            expected = '{"shape": "rectangle" or "ellipse", "width_mm": …, "height_mm": …}'
            raise InputError(file, place, repr(value)[:80], expected)
        assert width is not None and height is not None
        return _shape(shape, 0.5 * float(width), 0.5 * float(height))
    smooth = value.get("smooth", False)
    if "corners_mm" not in value or set(value) - {"corners_mm", "smooth"}:
        expected = '"shape" with "width_mm" and "height_mm", or "corners_mm", with "smooth" or not'
        raise InputError(file, place, f"the keys {', '.join(value) or 'none'}", expected)
    if not isinstance(smooth, bool):
        raise InputError(file, f"{place}.smooth", repr(smooth), "true or false")
    corners = _checked_shape(file, "outline.corners_mm", value["corners_mm"])
    assert not isinstance(corners, str)
    try:
        return RimCurve(corners, smooth)
    except InputError as error:
        raise InputError(file, place, error.actual, error.expected) from error


def _shape(shape: str, half_width: float, half_height: float) -> RimCurve:
    """A rectangle from its lower left corner, or an ellipse from its right end, about 0."""
    if shape == "rectangle":
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return RimCurve(tuple((x * half_width, y * half_height) for x, y in signs))
    angle = 2.0 * np.pi * np.arange(ELLIPSE_POINTS) / ELLIPSE_POINTS
    points = np.stack([half_width * np.cos(angle), half_height * np.sin(angle)], axis=-1)
    return RimCurve(tuple(map(tuple, points.tolist())), smooth=True)


def _checked_shares(file: str, value: Any) -> tuple[float, ...]:
    is_list = isinstance(value, list | tuple) and all(
        is_number(share) and 0.0 <= share <= 1.0 for share in value
    )
    if not is_list or not 0 < len(value) <= MAX_ELECTRODES:
        expected = "a list of shares of the rim's length, from 0 to 1"
        raise InputError(file, "skin.electrode_s", repr(value)[:80], expected)
    return tuple(map(float, value))


def _checked_shape(file: str, key: str, value: Any) -> str | tuple[tuple[float, float], ...]:
    if key == "outline" and isinstance(value, str) and value.strip():
        return value
    least_places = 1 if key == "electrode_xy_mm" else 3
    is_places = isinstance(value, list | tuple) and all(
        isinstance(place, list | tuple) and len(place) == 2 and all(map(is_number, place))
        for place in value
    )
    if not is_places or len(value) < least_places:
        word = "a word for the shape, or " if key == "outline" else ""
        expected = f"{word}places [x, y] in mm, {least_places} or more"
        raise InputError(file, f"skin.{key}", repr(value)[:80], expected)
    if key == "electrode_xy_mm" and len(value) > MAX_ELECTRODES:
        raise InputError(file, f"skin.{key}", f"{len(value)} places", ONE_EACH)
    return tuple((float(x), float(y)) for x, y in value)


def _listed(value: object) -> object:
    if isinstance(value, RimCurve):
        smooth = {"smooth": True} if value.smooth else {}
        return {"corners_mm": _listed(value.points_mm), **smooth}
    return [_listed(element) for element in value] if isinstance(value, tuple) else value


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value out of JSON or YAML is a finite number, LARGEST at most; true and false are
    none."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= LARGEST


def _checked_number(file: str, key: str, value: object) -> float:
    if not is_number(value):
        expected = f"a finite number or null{hint(value)}"
        raise InputError(file, f"skin.{key}", repr(value), expected)
    if key in POSITIVE and value < 1.0 / LARGEST:
        expected = "more than 0" if value <= 0 else f"{1.0 / LARGEST:g} or more"
        raise InputError(file, f"skin.{key}", repr(value), expected)
    if key in NOT_NEGATIVE and value < 0:
        raise InputError(file, f"skin.{key}", repr(value), "0 or more")
    return float(value)
