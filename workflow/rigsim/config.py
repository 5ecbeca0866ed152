"""The configuration of the emulated rig, and faults from its standard input."""

import json
from pathlib import Path

import jsonschema
import yaml

from eitskin import yaml_file
from eitskin.errors import InputError
from eitskin.schema import Validator, explained

SCHEMA = Path(__file__).parents[1] / "schemas" / "rigsim.schema.yaml"


def read_config(path: str | Path) -> dict:
    """The configuration. Raises InputError, one line, for no YAML and for a broken schema."""
    config = yaml_file.read(path)
    _refuse(path, config, _schema())
    return config


def read_fault(line: str) -> dict:
    """The fault in one line of JSON. Raises InputError where it is none."""
    try:
        fault = json.loads(line)
    except ValueError as error:
        raise InputError("standard input", "line", repr(line), "a fault as JSON") from error
    schema = _schema()
    _refuse("standard input", fault, {**schema["$defs"]["fault"], "$defs": schema["$defs"]})
    return fault


def _schema() -> dict:
    return yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))


def _refuse(file: str | Path, value: object, schema: dict) -> None:
    error = jsonschema.exceptions.best_match(Validator(schema).iter_errors(value))
    if error is not None:
        place, content, expected = explained(error)
        raise InputError(file, ".".join(map(str, place)) or "top level", content, expected)
