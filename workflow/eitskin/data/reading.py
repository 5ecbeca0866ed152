"""A recording of any format with what its owner states of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eitskin.data import importers, stated, subset
from eitskin.data.recording import Recording


def read(
    path: str | Path,
    skin: str | Path | Mapping[str, Any] | None = None,
    frames: tuple[int, int] | None = None,
    **settings: Any,
) -> Recording:
    """A recording of any known format.

    skin: what its owner knows of it, a YAML file or a mapping with the keys of one (radius_mm,
    electrode_deg, ...), in place of what the file says; frames: the first and the last frame to
    take, both counted, from 0; settings: format, order, drive, measure, part, array, frequency, as
    of `importers.load`. Raises InputError, which names file, place, what was found and expected.
    """
    source = skin if isinstance(skin, str | Path) else "skin"
    statements = dict(skin) if isinstance(skin, Mapping) else {}
    if isinstance(skin, str | Path):
        statements = stated.read(skin)
    stated.refuse(statements, source)
    recorded = stated.apply(statements, importers.load(path, **settings), source)
    return recorded if frames is None else subset.stretch(recorded, *frames, path)
