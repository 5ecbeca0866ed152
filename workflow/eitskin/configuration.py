"""The configuration: refused in one line where it is wrong, before any work."""

import math
from collections.abc import Iterable
from pathlib import Path

import jsonschema
import yaml
from jsonschema.exceptions import ValidationError, best_match

from eitskin.errors import InputError

MISSING = object()
NOUNS = {
    "number": "a finite number",
    "integer": "a whole number",
    "string": "a text",
    "boolean": "true or false",
    "array": "a list",
    "object": "a mapping of keys",
    "null": "null",
}


def _is_number(_checker: object, value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_integer(_checker: object, value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


Validator = jsonschema.validators.extend(
    jsonschema.Draft202012Validator,
    type_checker=jsonschema.Draft202012Validator.TYPE_CHECKER.redefine_many(
        {"number": _is_number, "integer": _is_integer}
    ),
)


def validate(config: dict, schema_path: str | Path, files: Iterable[str | Path]) -> None:
    """Check a merged configuration against its schema, its own names and the recordings' paths.

    `files` are the YAML files it was read from, later ones overriding earlier ones. Raises
    InputError, one line that names the file which holds the wrong value.
    """
    files = [Path(file) for file in files]
    schema = yaml.safe_load(Path(schema_path).read_text(encoding="utf-8"))
    errors = list(Validator(schema).iter_errors(config))
    if errors:
        error = min(errors, key=lambda error: _position(config, list(error.absolute_path)))
        place, found, expected = explained(error)
    else:
        wrong = _unknown_name(config) or _missing_recording(config)
        if wrong is None:
            return
        place, found, expected = wrong
    raise InputError(_file_of(place, config, files), _dotted(place), found, expected)


def explained(error: ValidationError) -> tuple[list, str, str]:
    """Place (keys and indices), what was found and what was expected, of a schema's error."""
    while error.validator in ("anyOf", "oneOf"):
        inner = [e for e in error.context if e.validator != "type" or len(e.path)]
        if not inner:
            break
        error = best_match(inner)
    place, value, wanted = list(error.absolute_path), error.instance, error.validator_value
    if error.validator == "additionalProperties":
        known = sorted(error.schema["properties"])
        key = next(key for key in value if key not in known)
        return [*place, key], "an unknown key", "one of " + ", ".join(known)
    if error.validator == "required":
        key = next(key for key in wanted if key not in value)
        meaning = error.schema.get("properties", {}).get(key, {})
        return [*place, key], "nothing", meaning.get("description", "a value")
    expected = {
        "type": lambda: _noun(wanted),
        "enum": lambda: "one of " + ", ".join(map(str, wanted)),
        "minimum": lambda: f"{wanted} or more",
        "exclusiveMinimum": lambda: f"more than {wanted}",
        "maximum": lambda: f"{wanted} or less",
        "exclusiveMaximum": lambda: f"less than {wanted}",
        "minItems": lambda: f"a list of {wanted} or more",
        "maxItems": lambda: f"a list of {wanted} or fewer",
        "uniqueItems": lambda: "a list without repetition",
        "minProperties": lambda: f"{wanted} or more keys",
    }.get(error.validator, lambda: error.schema["description"])()
    if isinstance(value, str) and _reads_as_number(value) and error.validator != "enum":
        expected += f" (YAML reads {value} as text; write {_yaml_number(value)})"
    return place, "null" if value is None else repr(value), expected


def _position(config: dict, place: list) -> tuple[int, list[int]]:
    """Depth of a place, then its order in the file: the first of the least deep comes first."""
    node, order = config, []
    for part in place:
        order.append(list(node).index(part) if isinstance(node, dict) else part)
        node = node[part]
    return len(place), order


def _noun(types: str | list[str]) -> str:
    return " or ".join(NOUNS[kind] for kind in ([types] if isinstance(types, str) else types))


def _reads_as_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _yaml_number(text: str) -> str:
    mantissa, _, exponent = text.lower().partition("e")
    if not exponent:
        return mantissa
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{mantissa}e{exponent if exponent[0] in '+-' else '+' + exponent}"


def _unknown_name(config: dict) -> tuple[list, str, str] | None:
    """A name in `table_1` that is not defined elsewhere in the configuration."""
    for kind in ("configurations", "recordings"):
        for name, splits in config["table_1"][kind].items():
            if name not in config[kind]:
                return ["table_1", kind, name], "an unknown name", _names(config[kind])
            for k, split in enumerate(splits):
                if split not in config["splits"]:
                    place = ["table_1", kind, name, k]
                    return place, repr(split), _names(config["splits"])
    for name in config["configurations"]:
        if f"simulated-{name}" in config["recordings"]:
            return ["recordings", f"simulated-{name}"], "a simulated set's name", "another name"
    return None


def _names(known: Iterable[str]) -> str:
    return "one of " + ", ".join(known)


def _missing_recording(config: dict) -> tuple[list, str, str] | None:
    """A recording's or query's file that is neither there nor made by the workflow itself."""
    for name, recording in config["recordings"].items():
        for key in ("path", "query"):
            path = recording.get(key)
            if path is not None and not path.startswith("results/") and not Path(path).exists():
                return ["recordings", name, key], f"no file {path!r}", "a recording's path"
    return None


def _dotted(place: list) -> str:
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text or "top level"


def _indices(node: object) -> range:
    return range(len(node)) if isinstance(node, list) else range(0)


def _file_of(place: list, config: dict, files: list[Path]) -> str:
    """The last file that holds what stands at `place`; for a missing key the first; or --config."""
    found = _at(place, config)
    if found is MISSING and files:
        return str(files[0])
    for file in reversed(files):
        held = _at(place, yaml.safe_load(file.read_text(encoding="utf-8")))
        if repr(held) == repr(found) or (isinstance(held, dict) and isinstance(found, dict)):
            return str(file)
    return "--config"


def _at(place: list, node: object) -> object:
    """What stands at `place` within nested mappings and lists, or MISSING."""
    for part in place:
        if part not in (node if isinstance(node, dict) else _indices(node)):
            return MISSING
        node = node[part]
    return node
