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
from eitskin.data.dataset import TARGETS
from eitskin.errors import InputError
from eitskin.exported.graph import Graph

HEADER = "header"
GRAPHS = ("activity", "strangeness", "states", "without")
KEYS = (
    *("format", "version", "model", "seeds", "dataset", "skin"),
    *("touch", "familiar", "intervals", "lost", "trained", "graphs"),
)
ARRAYS = ("scale", "touch_scale", "precision")
WORDS = (("dataset", "name"), ("dataset", "unit"), ("dataset", "voltage"))


@dataclass(frozen=True)
class Exported:
    """`header`: plain values, `graphs`: activity, strangeness and states of changes (B, M),
    and states without lost electrodes; `arrays`: what these need, the channels' precisions, and
    `untouched` (M,), the untouched skin trained on, where it is known."""

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
        if absent := sorted(_named(graph.plain()["steps"]) - arrays.keys()):
            raise InputError(path, f"header.graphs.{name}", f"no array {absent[0]}", "it")
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
    for section, key in WORDS:
        told = header[section].get(key, "") if isinstance(header[section], dict) else None
        if not isinstance(told, str) or (not told and key != "voltage"):
            raise InputError(path, f"header.{section}.{key}", repr(told), "a word")
    for place, held, shape in _shapes(header, arrays):
        try:
            values = np.array(held, dtype=float)
        except (TypeError, ValueError):
            values = np.array(np.nan)
        if values.shape != shape or not np.isfinite(values).all():
            told = f"numbers of shape {values.shape}" if held is not None else "nothing"
            raise InputError(path, place, told, f"finite numbers of shape {shape}")


def _shapes(header: dict, arrays: dict[str, np.ndarray]) -> list[tuple[str, object, tuple]]:
    """What else a file has to hold: place, content, shape; M channels, T targets, K classes of
    strength, as many as there are precisions."""
    dataset = header["dataset"]
    channels, targets = dataset.get("channels"), dataset.get("targets")
    m = len(channels) if isinstance(channels, list) else 0
    t = len(targets) if isinstance(targets, list) and set(map(str, targets)) <= set(TARGETS) else 0
    k = len(arrays["precision"]) if arrays["precision"].ndim else 0
    inner: dict[str, dict[str, tuple]] = {
        "dataset": {"channels": (m or 1, 4)},
        "touch": {"threshold": ()},
        "familiar": {"limit_distance": (), "limit_residual": ()},
        "intervals": {
            **{"edges": (k - 1,), "half": (k, t or 1)},
            **{"half_without": (2, k, t), "widening": (t,)},
        },
        "lost": {"single": (k,), "electrode": (k,)},
        "trained": {"weakest": (), "range": (2, t)},
    }
    found = []
    for section, keys in inner.items():
        held = header[section] if isinstance(header[section], dict) else {}
        found += [(f"header.{section}.{key}", held.get(key), s) for key, s in keys.items()]
    shapes = {"scale": (m,), "touch_scale": (m,), "precision": (k, m, m), "untouched": (m,)}
    return found + [
        (f"array {name}", arrays[name], shape) for name, shape in shapes.items() if name in arrays
    ]


def _named(argument: object) -> set[str]:
    """The arrays that arguments of steps name."""
    if isinstance(argument, dict):
        own = {str(argument["array"])} if "array" in argument else set()
        return own.union(*map(_named, argument.values()))
    return set().union(*map(_named, argument)) if isinstance(argument, list) else set()
