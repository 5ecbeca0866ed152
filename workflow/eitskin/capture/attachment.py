"""A rig attached by the workflow's configuration, and the recording that it captures.

A recording that is not captured yet is removed from the configuration, so that no other rule ever
starts a robot.
"""

import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from eitskin.capture import configuration
from eitskin.capture.press_plan import plan_sha256
from eitskin.configuration import COMMAND_LINE, PATHS, captured_path, file_of
from eitskin.errors import InputError
from eitskin.schema import dotted


def manifest_path(name: str) -> str:
    """Where the manifest of a captured recording lies."""
    return f"results/recordings/{name}.manifest.json"


def attach(config: dict, files: Iterable[str | Path], fallback: str = COMMAND_LINE) -> None:
    """Add the capture of `config["rig"]` to the recordings if it is complete, else remove it from
    everything that names it.

    `config` is valid by its schema; `files` and `fallback` are those it was read from, as in
    `configuration.validate`. Raises InputError for a rig that cannot be driven safely, a name of
    another recording, an existing capture by another rig or plan, and a figure or recording that
    needs a capture which does not exist.
    """
    rig = config["rig"]
    name, file = rig["name"], file_of(["rig"], config, files, fallback)
    configuration.check(rig, file)
    path = captured_path(name)
    recording_entry = config["recordings"].setdefault(name, {"path": path})
    if recording_entry["path"] != path:
        raise InputError(file, "rig.name", f"{name}, a recording's", f"another, or its path {path}")
    if Path(path).is_file() and Path(manifest_path(name)).is_file():
        if _manifest(name).get("plan_sha256") != plan_sha256(rig):
            expected = f"that of {manifest_path(name)}, or another name"
            raise InputError(file, "rig", "another rig or plan", expected)
        return
    for place in _references(name, config):
        absence = f"{name}, which is not captured yet"
        config_file = file_of(place, config, files, fallback)
        raise InputError(config_file, dotted(place), absence, "a recording that is there")
    _remove_recording(name, config)
    print(f"{name} is not captured yet and left out; `snakemake capture` does it", file=sys.stderr)


def _manifest(name: str) -> dict:
    try:
        manifest = json.loads(Path(manifest_path(name)).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(manifest_path(name), "file", error, "a capture's manifest") from error
    if not isinstance(manifest, dict):
        raise InputError(
            manifest_path(name), "file", type(manifest).__name__, "a capture's manifest"
        )
    return manifest


def _references(name: str, config: dict) -> Iterator[list]:
    """Places of the configuration that name a recording and cannot do without it."""
    if config["figures"]["recording"] == name:
        yield ["figures", "recording"]
    files = {captured_path(name), manifest_path(name)}
    for recording_name, recording_entry in config["recordings"].items():
        for key in PATHS if recording_name != name else ():
            if os.path.normpath(recording_entry.get(key, "")) in files:
                yield ["recordings", recording_name, key]


def _remove_recording(name: str, config: dict) -> None:
    """Remove a recording from every mapping and list of the configuration."""
    mappings = [config["recordings"], config["table_1"]["recordings"]]
    mappings += [config["ablation"][key] for key in ("varied_on", "compared_on")]
    for mapping in mappings:
        mapping.pop(name, None)
    for recording_names in (
        config["diagnoses"],
        config["transfer"]["targets"],
        config["tanks"],
        config["loop"]["recordings"],
    ):
        recording_names[:] = [
            recording_name for recording_name in recording_names if recording_name != name
        ]
