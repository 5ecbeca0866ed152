"""A rig that the workflow's configuration attaches, and the recording that it captures.

A recording that is not captured yet is no recording of the workflow: nothing but the capture that
somebody asks for may ever need a robot.
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
    """Where the manifest lies of what a rig has captured under a name."""
    return f"results/recordings/{name}.manifest.json"


def attach(config: dict, files: Iterable[str | Path], rest: str = COMMAND_LINE) -> None:
    """Make the capture of `config["rig"]` one of the recordings, where it is there whole; else take
    it out of everything that names it.

    `config` is valid by its schema, read from `files` and `rest` as `validate` has them. Raises
    InputError for a rig that cannot be driven safely, a name that another recording has, a capture
    that is there by another rig or plan, and figures or another recording that are of a capture
    which is not there.
    """
    rig = config["rig"]
    name, file = rig["name"], file_of(["rig"], config, files, rest)
    configuration.check(rig, file)
    path = captured_path(name)
    listed = config["recordings"].setdefault(name, {"path": path})
    if listed["path"] != path:
        raise InputError(file, "rig.name", f"{name}, a recording's", f"another, or its path {path}")
    if Path(path).is_file() and Path(manifest_path(name)).is_file():
        if _manifest(name).get("plan_sha256") != plan_sha256(rig):
            expected = f"that of {manifest_path(name)}, or another name"
            raise InputError(file, "rig", "another rig or plan", expected)
        return
    for place in _needing(name, config):
        found = f"{name}, which is not captured yet"
        holder = file_of(place, config, files, rest)
        raise InputError(holder, dotted(place), found, "a recording that is there")
    _leave_out(name, config)
    print(f"{name} is not captured yet and left out; `snakemake capture` does it", file=sys.stderr)


def _manifest(name: str) -> dict:
    try:
        found = json.loads(Path(manifest_path(name)).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(manifest_path(name), "file", error, "a capture's manifest") from error
    if not isinstance(found, dict):
        raise InputError(manifest_path(name), "file", type(found).__name__, "a capture's manifest")
    return found


def _needing(name: str, config: dict) -> Iterator[list]:
    """Where a recording is named that cannot be left out."""
    if config["figures"]["recording"] == name:
        yield ["figures", "recording"]
    files = {captured_path(name), manifest_path(name)}
    for other, item in config["recordings"].items():
        for key in PATHS if other != name else ():
            if os.path.normpath(item.get(key, "")) in files:
                yield ["recordings", other, key]


def _leave_out(name: str, config: dict) -> None:
    """Take a recording out of everything that names it."""
    mappings = [config["recordings"], config["table_1"]["recordings"]]
    mappings += [config["ablation"][key] for key in ("varied_on", "compared_on")]
    for mapping in mappings:
        mapping.pop(name, None)
    for names in (
        config["diagnoses"],
        config["transfer"]["targets"],
        config["tanks"],
        config["loop"]["recordings"],
    ):
        names[:] = [other for other in names if other != name]
