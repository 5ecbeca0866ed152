"""The file of an exported predictor: a zip of NumPy arrays and a JSON header that describes them.

Reading a file never runs code from it: arrays are read without pickle, operations are looked up by
name in `graph.OPERATIONS`.
"""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin import unfolding
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
TEXT_KEYS = (("dataset", "name"), ("dataset", "unit"), ("dataset", "voltage"))


@dataclass(frozen=True)
class Exported:
    """The content of a file: `header`, values of JSON; `graphs`, the activity, strangeness and
    states of changes (B, M), and the states without lost electrodes; `arrays`, those of the graphs,
    the channels' precisions and, where known, `untouched` (M,), the readings of the untouched skin
    trained on."""

    header: dict
    graphs: dict[str, Graph]
    arrays: dict[str, np.ndarray]


def write(exported: Exported, path: str | Path) -> None:
    """Write the file, atomically; equal contents give equal bytes."""
    graphs = {name: graph.as_json() for name, graph in exported.graphs.items()}
    header = {**exported.header, "graphs": graphs}
    text = json.dumps(header, sort_keys=True, allow_nan=False)
    members = {**exported.arrays, HEADER: np.frombuffer(text.encode(), np.uint8)}
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **members)


def read(path: str | Path) -> Exported:
    """Read and check a file; raises InputError."""
    expected = "an exported predictor"
    try:
        if zipfile.is_zipfile(path):
            unfolding.refuse_archive(path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        header = json.loads(arrays.pop(HEADER).tobytes())
    except FileNotFoundError:
        raise InputError(path, "file", "no such file", expected) from None
    except OSError as error:
        raise InputError(path, "file", error.strerror or "no archive", expected) from None
    except (ValueError, EOFError, KeyError, TypeError, AttributeError, zipfile.BadZipFile):
        raise InputError(path, "file", "another content", expected) from None
    _check(path, header, arrays)
    try:
        graphs = {name: Graph.from_json(plain) for name, plain in header.pop("graphs").items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(path, "header.graphs", "another form", "input, steps, outputs") from None
    if missing := [name for name in GRAPHS if name not in graphs]:
        raise InputError(path, "header.graphs", f"no {missing[0]}", f"{', '.join(GRAPHS)}")
    for name, graph in graphs.items():
        if unknown := graph.unknown_operations():
            raise InputError(path, f"header.graphs.{name}", unknown[0], "a known operation")
        if absent := sorted(_named(graph.as_json()["steps"]) - arrays.keys()):
            raise InputError(path, f"header.graphs.{name}", f"no array {absent[0]}", "it")
    return Exported(header, graphs, arrays)


def _check(path: str | Path, header: object, arrays: dict[str, np.ndarray]) -> None:
    if not isinstance(header, dict):
        raise InputError(path, "header", type(header).__name__, "an object")
    for key in KEYS:
        if key not in header:
            raise InputError(path, f"header.{key}", "nothing", f"the keys {', '.join(KEYS)}")
    if (header["format"], header["version"]) != ("eitskin-predictor", 1):
        format_and_version = f"{header['format']!r}, {header['version']!r}"
        raise InputError(
            path, "header.format, version", format_and_version, "'eitskin-predictor', 1"
        )
    for name in ARRAYS:
        if name not in arrays:
            raise InputError(path, f"array {name}", "nothing", f"{', '.join(ARRAYS)}")
    for section, key in TEXT_KEYS:
        text = header[section].get(key, "") if isinstance(header[section], dict) else None
        if not isinstance(text, str) or (not text and key != "voltage"):
            raise InputError(path, f"header.{section}.{key}", repr(text), "a word")
    for location, content, shape in _shapes(header, arrays):
        try:
            values = np.array(content, dtype=float)
        except (TypeError, ValueError):
            values = np.array(np.nan)
        if values.shape != shape or not np.isfinite(values).all():
            text = f"numbers of shape {values.shape}" if content is not None else "nothing"
            raise InputError(path, location, text, f"finite numbers of shape {shape}")


def _shapes(header: dict, arrays: dict[str, np.ndarray]) -> list[tuple[str, object, tuple]]:
    """The numbers a file has to hold, as location, values and shape; the counts of channels,
    targets and classes of strength are those of the table, the targets and the precisions."""
    dataset = header["dataset"]
    channels, targets = dataset.get("channels"), dataset.get("targets")
    channel_count = len(channels) if isinstance(channels, list) else 0
    target_count = (
        len(targets) if isinstance(targets, list) and set(map(str, targets)) <= set(TARGETS) else 0
    )
    class_count = len(arrays["precision"]) if arrays["precision"].ndim else 0
    header_shapes: dict[str, dict[str, tuple]] = {
        "dataset": {"channels": (channel_count or 1, 4)},
        "touch": {"threshold": ()},
        "familiar": {"limit_distance": (), "limit_residual": ()},
        "intervals": {
            **{"edges": (class_count - 1,), "half": (class_count, target_count or 1)},
            **{"half_without": (2, class_count, target_count), "widening": (target_count,)},
        },
        "lost": {"single": (class_count,), "electrode": (class_count,)},
        "trained": {"weakest": (), "range": (2, target_count)},
    }
    expected = []
    for section, keys in header_shapes.items():
        values = header[section] if isinstance(header[section], dict) else {}
        expected += [
            (f"header.{section}.{key}", values.get(key), shape) for key, shape in keys.items()
        ]
    shapes = {
        "scale": (channel_count,),
        "touch_scale": (channel_count,),
        "precision": (class_count, channel_count, channel_count),
        "untouched": (channel_count,),
    }
    return expected + [
        (f"array {name}", arrays[name], shape) for name, shape in shapes.items() if name in arrays
    ]


def _named(argument: object) -> set[str]:
    """The names of all arrays in the arguments of steps."""
    if isinstance(argument, dict):
        names = {str(argument["array"])} if "array" in argument else set()
        return names.union(*map(_named, argument.values()))
    return set().union(*map(_named, argument)) if isinstance(argument, list) else set()
