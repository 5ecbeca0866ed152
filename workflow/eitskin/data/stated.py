"""What the owner of a skin states of it and of its readings, beside what his file says.

A mapping with keys of the recording format: those of `skin` (radius_mm, electrode_deg, ...), and of
the others those that say how the readings were taken. What is stated replaces what the file says;
null says that it is not known.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from eitskin import yaml_file
from eitskin.data.recording import CHOICES, Recording, check_reading, validate
from eitskin.errors import InputError
from eitskin.physics.outline import rim_angles
from eitskin.physics.skin import Skin

SKIN = tuple(field.name for field in fields(Skin))
READING = ("frame_s", *(key for key in CHOICES if key != "format"))
KEYS = (*SKIN, *READING)


def read(path: str | Path) -> dict:
    """What a YAML file states. Raises InputError for what is no YAML, an unknown key or a value
    that the recording format refuses."""
    said = yaml_file.read(path)
    refuse(said, path)
    return said


def refuse(said: dict, file: str | Path = "skin") -> None:
    """Raise InputError, with `file` as its place, for an unknown key or a value that the recording
    format refuses."""
    for key in said:
        if key not in KEYS:
            raise InputError(file, str(key), "an unknown key", f"one of {', '.join(KEYS)}")
    try:
        Skin.from_metadata(dict.fromkeys(SKIN) | _part(said, SKIN))
        check_reading(_part(said, READING), file)
    except InputError as error:
        place = error.place.removeprefix("skin.").removeprefix("key ")
        raise InputError(file, place, error.actual, error.expected) from error


def apply(said: dict, recording: Recording, file: str | Path = "skin") -> Recording:
    """The recording with what its owner states (`refuse`d before); `source` says which keys.

    Raises InputError, with `file` as its place, where recording and statement do not fit together.
    """
    if not said:
        return recording
    metadata = recording.metadata
    angles = said.get("electrode_deg")
    named = int(np.max(metadata["channels"])) + 1
    if angles is not None and len(angles) < named:
        expected = f"{named} or more: the channels name electrodes 0 to {named - 1}"
        raise InputError(file, "electrode_deg", f"{len(angles)} angles", expected)
    source = f"{metadata['source']}; its owner states {', '.join(said)}"
    skin = metadata["skin"] | _part(said, SKIN)
    if said.get("electrode_xy_mm") and angles is None:
        skin["electrode_deg"] = rim_angles(said["electrode_xy_mm"]).tolist()
    changed = {**metadata, **_part(said, READING), "skin": skin, "source": source}
    told = replace(recording, metadata=changed)
    validate(told, file)
    return told


def _part(said: dict, keys: tuple[str, ...]) -> dict:
    return {key: value for key, value in said.items() if key in keys}
