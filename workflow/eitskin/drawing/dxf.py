"""Curves of a DXF drawing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
from ezdxf import units
from ezdxf.math import Vec3

from eitskin.drawing.curves import CURVE_POINTS, Curve, Drawing
from eitskin.errors import InputError, refused

UNITLESS = 0  # of $INSUNITS
SAG_SHARE = 1e-5  # of a curve's extent, which its chords may leave
BENT = ("ARC", "CIRCLE", "ELLIPSE", "SPLINE")
COMPOUND = ("LWPOLYLINE", "POLYLINE", "INSERT")
DEEPEST = 8  # blocks within blocks


def read(path: str | Path) -> Drawing:
    """The curves on layers that are on, in modelspace.

    Raises InputError for a file that cannot be read and for one that is no DXF.
    """
    try:
        document = ezdxf.readfile(str(path))
    except ezdxf.DXFError as error:
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
    return Drawing(
        tuple(curves), None if unit == UNITLESS else units.conversion_factor(unit, units.MM)
    )


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
    elif kind in BENT:
        coarse = _complex(list(entity.flattening(1.0))) if kind == "SPLINE" else None
        size = entity.dxf.radius if kind in ("ARC", "CIRCLE") else _size(entity, coarse)
        if not size > 0:
            return []
        piece = _complex(list(entity.flattening(SAG_SHARE * size)))
        if len(piece) == 2:
            piece = np.linspace(piece[0], piece[1], CURVE_POINTS)
    else:
        return []
    return [piece] if np.ptp(piece.real) or np.ptp(piece.imag) else []


def _size(entity: Any, coarse: np.ndarray | None) -> float:
    if coarse is None:
        return float(Vec3(entity.dxf.major_axis).magnitude)
    return float(max(np.ptp(coarse.real), np.ptp(coarse.imag)))


def _complex(points: list) -> np.ndarray:
    return np.array([complex(point[0], point[1]) for point in points])
