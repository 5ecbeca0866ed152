"""Curves of a DXF drawing."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from ezdxf import units
from ezdxf.enums import InsertUnits
from ezdxf.filemanagement import readfile
from ezdxf.lldxf.const import DXFError

from eitskin.drawing.curves import CURVE_POINTS, Curve, Drawing
from eitskin.errors import InputError, refused

UNITLESS = 0  # of $INSUNITS
SAG_SHARE = 1e-5  # of a spline's extent, which its chords may leave
COMPOUND = ("LWPOLYLINE", "POLYLINE", "INSERT")
DEEPEST = 8  # blocks within blocks


def read(path: str | Path) -> Drawing:
    """The curves on layers that are on, in modelspace.

    Raises InputError for a file that cannot be read and for one that is no DXF.
    """
    try:
        document = readfile(str(path))
    except DXFError as error:
        raise InputError(path, "file", str(error).partition("\n")[0], "a DXF drawing") from error
    except UnicodeDecodeError as error:
        raise InputError(path, f"byte {error.start}", "no text", "a DXF drawing") from error
    except OSError as error:
        if error.errno is None:
            raise InputError(path, "file", "no DXF", "a DXF drawing") from error
        raise refused(error, path, expected="a DXF drawing") from error
    hidden = {layer.dxf.name for layer in document.layers if layer.is_off() or layer.is_frozen()}
    curves = [
        curve
        for entity in document.modelspace()
        if entity.dxf.layer not in hidden
        for curve in _curves(entity, frozenset(), DEEPEST)
    ]
    unit = document.header.get("$INSUNITS", UNITLESS)
    if unit == UNITLESS:
        return Drawing(tuple(curves), None)
    try:
        factor = units.conversion_factor(InsertUnits(unit), InsertUnits.Millimeters)
    except ValueError as error:
        raise InputError(path, "$INSUNITS", unit, "1 inch, 4 mm, 5 cm or 6 m") from error
    return Drawing(tuple(curves), factor)


def _curves(entity: Any, names: frozenset[str], depth: int) -> Iterator[Curve]:
    """Curves of an entity; of a block those of its entities."""
    kind, layer = entity.dxftype(), entity.dxf.layer
    named = names | {layer.strip().lower()}
    place = f"{kind} {entity.dxf.handle or ''}, layer {layer!r}".replace(" ,", ",")
    if kind == "INSERT":
        if depth:
            for part in entity.virtual_entities():
                yield from _curves(part, named, depth - 1)
        return
    if kind in COMPOUND:
        parts = [piece for part in entity.virtual_entities() for piece in _pieces(part)]
    else:
        parts = _pieces(entity)
    if parts:
        yield Curve(tuple(parts), named, place)


def _pieces(entity: Any) -> list[np.ndarray]:
    """A piece of an entity; none of one that is no curve, or without extent."""
    kind = entity.dxftype()
    if kind == "POINT":
        return [_complex([entity.dxf.location])]
    if kind == "LINE":
        piece = _complex([entity.dxf.start, entity.dxf.end])
    elif kind == "CIRCLE":
        piece = _complex(entity.vertices(np.linspace(0.0, 360.0, CURVE_POINTS)))
    elif kind == "ARC":
        start, end = entity.dxf.start_angle, entity.dxf.end_angle
        span = (end - start) % 360.0 or 360.0
        piece = _complex(entity.vertices(np.linspace(start, start + span, CURVE_POINTS)))
    elif kind == "ELLIPSE":
        start, end = entity.dxf.start_param, entity.dxf.end_param
        span = (end - start) % (2.0 * np.pi) or 2.0 * np.pi
        piece = _complex(entity.vertices(np.linspace(start, start + span, CURVE_POINTS)))
    elif kind == "SPLINE":
        coarse = _complex(entity.flattening(1.0))
        size = float(max(np.ptp(coarse.real), np.ptp(coarse.imag)))
        if not size > 0:
            return []
        piece = _complex(entity.flattening(SAG_SHARE * size))
        if len(piece) == 2:
            piece = np.linspace(piece[0], piece[1], CURVE_POINTS)
    else:
        return []
    return [piece] if np.ptp(piece.real) or np.ptp(piece.imag) else []


def _complex(points: Iterable[Any]) -> np.ndarray:
    return np.array([complex(point[0], point[1]) for point in points])
