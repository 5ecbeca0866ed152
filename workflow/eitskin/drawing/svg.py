"""Curves of an SVG drawing."""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import svgelements

from eitskin import text_file
from eitskin.drawing.curves import CURVE_POINTS, Curve, Drawing
from eitskin.errors import InputError, refused

ROOT = "{http://www.w3.org/2000/svg}svg"
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
UNITS_MM = {
    **{"mm": 1.0, "cm": 10.0, "in": 25.4},
    **{"pt": 25.4 / 72.0, "pc": 25.4 / 6.0, "Q": 0.25},
}
PIXEL_MM = 25.4 / 96.0  # of CSS
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
LENGTH = re.compile(rf"\s*(?:{NUMBER}\s*(?:px|{'|'.join(UNITS_MM)})?|auto)\s*")
FORMS = {
    "d": (re.compile(rf"(?:[MmLlHhVvCcSsQqTtAaZz]|{NUMBER}|[\s,])*"), "the data of a path"),
    "points": (re.compile(rf"(?:{NUMBER}|[\s,])*"), "pairs of numbers"),
}
ATTRIBUTES = {  # numbers of shapes
    "path": ("d",),
    "polygon": ("points",),
    "polyline": ("points",),
    "rect": ("x", "y", "width", "height", "rx", "ry"),
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "line": ("x1", "y1", "x2", "y2"),
}
STRAIGHT = (svgelements.Line, svgelements.Close)


def read(path: str | Path) -> Drawing:
    """The visible curves of an SVG file.

    Raises InputError for a file that cannot be read, one that is no XML, and one that is no SVG.
    """
    try:
        text = text_file.read(path)
    except OSError as error:
        raise refused(error, path, expected="an SVG drawing") from error
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except ElementTree.ParseError as error:
        line, column = error.position
        place = f"line {line}, column {column + 1}"
        actual = str(error).partition(":")[0]
        raise InputError(path, place, actual, "XML, as an SVG drawing is") from error
    if root.tag not in (ROOT, "svg"):
        raise InputError(path, "line 1", f"<{root.tag}>", "<svg>")
    for element in root.iter():
        _refuse_unreadable(element, path)
    unit_mm = _unit_mm(root)
    for name in ("width", "height", "viewBox", "preserveAspectRatio"):  # what scales the rest
        root.attrib.pop(name, None)
    content = io.BytesIO(ElementTree.tostring(root, encoding="utf-8"))
    try:
        shapes = svgelements.SVG.parse(content, reify=True)
    except (ValueError, TypeError, AttributeError, LookupError, ZeroDivisionError) as error:
        expected = "shapes whose numbers can be read"
        raise InputError(path, "shapes", str(error) or type(error).__name__, expected) from error
    return Drawing(tuple(_curves(shapes, frozenset(), [0])), unit_mm)


def _refuse_unreadable(element: ElementTree.Element, path: str | Path) -> None:
    """Raise InputError for a number of a shape that is none, of which a reader would make 0."""
    tag = str(element.tag).rpartition("}")[2]
    name = f"{tag} {element.get('id', '')!r}" if element.get("id") else tag
    for key in ATTRIBUTES.get(tag, ()):
        value = element.get(key)
        form, expected = FORMS.get(key, (LENGTH, "a number, in the units of the drawing"))
        if value is not None and not form.fullmatch(value):
            raise InputError(path, f"{name}, {key}", repr(value), expected)


def _unit_mm(root: ElementTree.Element) -> float | None:
    """How many mm a user unit is by width, height and viewBox; None where width says no unit."""
    lengths = [_length_mm(root.get(name, "")) for name in ("width", "height")]
    if lengths[0] is None:
        return None
    box = [float(number) for number in re.findall(NUMBER, root.get("viewBox", ""))]
    if len(box) != 4 or box[2] <= 0 or box[3] <= 0:
        return PIXEL_MM
    scales = [
        length / side for length, side in zip(lengths, box[2:], strict=True) if length is not None
    ]
    return min(scales)


def _length_mm(text: str) -> float | None:
    """A length with a unit of UNITS_MM."""
    parts = re.fullmatch(rf"\s*({NUMBER})\s*([a-zA-Z]+)\s*", text)
    if parts is None or parts[2] not in UNITS_MM or float(parts[1]) <= 0:
        return None
    return float(parts[1]) * UNITS_MM[parts[2]]


def _curves(group: svgelements.Group, names: frozenset[str], numbers: list[int]) -> Iterator[Curve]:
    """Curves of a group and the groups in it, a subpath each."""
    for element in group:
        attributes = getattr(element, "values", {}).get("attributes", {})
        words = (attributes.get("id"), attributes.get(LABEL))
        words += (*str(attributes.get("class", "")).split(),)
        named = names | {word.strip().lower() for word in words if word}
        if isinstance(element, svgelements.Group):
            yield from _curves(element, named, numbers)
        elif isinstance(element, svgelements.Shape):
            numbers[0] += 1
            name = attributes.get("id")
            tag = attributes.get("tag", "path")
            place = f"{tag} {name!r}" if name else f"shape {numbers[0]}, a {tag}"
            path = svgelements.Path(element)
            path.reify()  # a turned rectangle or ellipse is one only as a path
            for subpath in path.as_subpaths():
                pieces = tuple(_pieces(svgelements.Path(subpath)))
                if pieces:
                    yield Curve(pieces, named, place)


def _pieces(path: svgelements.Path) -> Iterator[np.ndarray]:
    """Pieces with an extent, y upwards."""
    for segment in path:
        if isinstance(segment, svgelements.Move) or segment.start is None or segment.end is None:
            continue
        count = 2 if isinstance(segment, STRAIGHT) else CURVE_POINTS
        shares = np.linspace(0.0, 1.0, count)
        x, y = np.array([tuple(segment.point(share)) for share in shares], float).T
        piece = x - 1j * y
        if np.ptp(x) or np.ptp(y):
            yield piece
