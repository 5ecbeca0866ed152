"""The file of an exported predictor: a zip of NumPy arrays, and JSON that says what they are.

Reading it runs nothing that the file brings: arrays are read without pickle, operations by name out
of `graph.OPERATIONS`.
"""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from eitskin.exported.graph import Graph

HEADER = "header"
GRAPHS = ("activity", "strangeness", "states", "without")
KEYS = (
    *("format", "version", "model", "seeds", "dataset", "skin", "frame_s"),
    *("touch", "familiar", "intervals", "lost", "graphs"),
)
ARRAYS = ("scale", "touch_scale", "precision")


@dataclass(frozen=True)
class Exported:
    """`header`: plain values, `graphs`: activity, strangeness and states of changes (B, M),
    and states without lost electrodes; `arrays`: what these need, the channels' precisions."""

    header: dict
    graphs: dict[str, Graph]
    arrays: dict[str, np.ndarray]


def write(exported: Exported, path: str | Path) -> None:
    """Write the file, atomically; equal contents give equal bytes."""
    graphs = {name: graph.plain() for name, graph in exported.graphs.items()}
    header = {**exported.header, "graphs": graphs}
    text = json.dumps(header, sort_keys=True, allow_nan=False)
    held = {**exported.arrays, HEADER: np.frombuffer(text.encode(), np.uint8)}
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **held)


def read(path: str | Path) -> Exported:
    """Read and check a file; raises InputError."""
    expected = "an exported predictor"
    try:
        with np.load(path, allow_pickle=False) as held:
            arrays = {name: held[name] for name in held.files}
        header = json.loads(arrays.pop(HEADER).tobytes())
    except FileNotFoundError:
        raise InputError(path, "file", "no such file", expected) from None
    except OSError as error:
        raise InputError(path, "file", error.strerror or "no archive", expected) from None
    except (ValueError, EOFError, KeyError, TypeError, AttributeError, zipfile.BadZipFile):
        raise InputError(path, "file", "another content", expected) from None
    _check(path, header, arrays)
    try:
        graphs = {name: Graph.of(plain) for name, plain in header.pop("graphs").items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(path, "header.graphs", "another form", "input, steps, outputs") from None
    if missing := [name for name in GRAPHS if name not in graphs]:
        raise InputError(path, "header.graphs", f"no {missing[0]}", f"{', '.join(GRAPHS)}")
    for name, graph in graphs.items():
        if unknown := graph.unknown():
            raise InputError(path, f"header.graphs.{name}", unknown[0], "a known operation")
    return Exported(header, graphs, arrays)


def _check(path: str | Path, header: object, arrays: dict[str, np.ndarray]) -> None:
    if not isinstance(header, dict):
        raise InputError(path, "header", type(header).__name__, "an object")
    for key in KEYS:
        if key not in header:
            raise InputError(path, f"header.{key}", "nothing", f"the keys {', '.join(KEYS)}")
    if (header["format"], header["version"]) != ("eitskin-predictor", 1):
        found = f"{header['format']!r}, {header['version']!r}"
        raise InputError(path, "header.format, version", found, "'eitskin-predictor', 1")
    for name in ARRAYS:
        if name not in arrays:
            raise InputError(path, f"array {name}", "nothing", f"{', '.join(ARRAYS)}")
