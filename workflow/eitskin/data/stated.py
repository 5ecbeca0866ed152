"""Properties of a skin and its readings that the owner states beside the recording's file.

A mapping with keys of the recording format: those of `skin` (radius_mm, electrode_deg, ...), and
those that describe how the readings were taken. A stated value replaces the file's; null means
unknown.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from eitskin import yaml_file
from eitskin.data.recording import CHOICES, Recording, check_reading, validate
from eitskin.errors import InputError
from eitskin.physics.outline import inside_mm, rim_angles
from eitskin.physics.skin import Skin

SKIN = tuple(field.name for field in fields(Skin))
READING = ("frame_s", *(key for key in CHOICES if key != "format"))
KEYS = (*SKIN, *READING)


def read(path: str | Path) -> dict:
    """The statement in a YAML file; its keys may stand under `skin:`, as in a configuration.

    Raises InputError for another file, an unknown key, and a value that the format refuses.
    """
    statement = yaml_file.read(path)
    if set(statement) == {"skin"} and isinstance(statement["skin"], dict):
        statement = statement["skin"]
    refuse(statement, path)
    return statement


def refuse(statement: dict, file: str | Path = "skin") -> None:
    """Raise InputError naming `file` for an unknown key or a value that the format refuses."""
    for key in statement:
        if key not in KEYS:
            raise InputError(file, str(key), "an unknown key", f"one of {', '.join(KEYS)}")
    try:
        Skin.from_metadata(dict.fromkeys(SKIN) | _part(statement, SKIN))
        check_reading(_part(statement, READING), file)
    except InputError as error:
        place = error.place.removeprefix("skin.").removeprefix("key ")
        raise InputError(file, place, error.actual, error.expected) from error


def apply(statement: dict, recording: Recording, file: str | Path = "skin") -> Recording:
    """The recording with a checked statement applied; its `source` lists the stated keys.

    Raises InputError naming `file` where recording and statement contradict each other.
    """
    if not statement:
        return recording
    metadata = recording.metadata
    angles = statement.get("electrode_deg")
    n_named = int(np.max(metadata["channels"])) + 1
    if angles is not None and len(angles) < n_named:
        expected = f"{n_named} or more: the channels name electrodes 0 to {n_named - 1}"
        raise InputError(file, "electrode_deg", f"{len(angles)} angles", expected)
    source = f"{metadata['source']}; its owner states {', '.join(statement)}"
    skin = metadata["skin"] | _part(statement, SKIN)
    is_angled = statement.get("electrode_xy_mm") and angles is None and not _is_outline(statement)
    if is_angled and inside_mm(Skin.from_metadata(skin, str(file))) is not None:
        skin["electrode_deg"] = None
    elif is_angled:
        skin["electrode_deg"] = rim_angles(statement["electrode_xy_mm"]).tolist()
    stated_metadata = {**metadata, **_part(statement, READING), "skin": skin, "source": source}
    stated_recording = replace(recording, metadata=stated_metadata)
    try:
        validate(stated_recording, file)
    except InputError as error:
        if not error.place.startswith("column"):
            raise
        place = f"beside {error.place} of the recording"
        raise InputError(file, place, error.actual, error.expected) from error
    return stated_recording


def _is_outline(statement: dict) -> bool:
    """Whether it states a rim that is no disc."""
    return isinstance(statement.get("outline"), dict)


def _part(statement: dict, keys: tuple[str, ...]) -> dict:
    return {key: value for key, value in statement.items() if key in keys}
