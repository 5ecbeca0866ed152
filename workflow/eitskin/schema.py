"""Errors of a JSON schema as place, actual and expected value."""

from collections.abc import Callable, Iterable
from difflib import get_close_matches

import jsonschema
import yaml
from jsonschema.exceptions import ValidationError, best_match

from eitskin.physics.skin import is_number
from eitskin.yaml_number import reads_as_number, yaml_number

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
    return is_number(value)


def _is_integer(_checker: object, value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


Validator = jsonschema.validators.extend(
    jsonschema.Draft202012Validator,
    type_checker=jsonschema.Draft202012Validator.TYPE_CHECKER.redefine_many(
        {"number": _is_number, "integer": _is_integer}
    ),
)


def explained(error: ValidationError) -> tuple[list, str, str]:
    """Place (keys and indices), actual and expected value of an error of a schema."""
    while error.validator in ("anyOf", "oneOf"):
        inner = [e for e in error.context if e.validator != "type" or len(e.path)]
        if not inner:
            break
        error = best_match(inner)
    place, value, limit = list(error.absolute_path), error.instance, error.validator_value
    if error.validator == "additionalProperties":
        keys = sorted(error.schema["properties"])
        key = next(key for key in value if key not in keys)
        return [*place, key], "an unknown key", one_of(keys, key)
    if error.validator == "required":
        key = next(key for key in limit if key not in value)
        meaning = error.schema.get("properties", {}).get(key, {})
        return [*place, key], "no such key", meaning.get("description", "a value")
    sayings: dict[str, Callable[[], str]] = {
        "type": lambda: _noun(limit),
        "enum": lambda: one_of(map(str, limit), value),
        "minimum": lambda: f"{limit} or more",
        "exclusiveMinimum": lambda: f"more than {limit}",
        "maximum": lambda: f"{limit} or less",
        "exclusiveMaximum": lambda: f"less than {limit}",
        "minItems": lambda: f"a list of {limit} or more",
        "maxItems": lambda: f"a list of {limit} or fewer",
        "uniqueItems": lambda: "a list without repetition",
        "minProperties": lambda: f"{limit} or more keys",
    }
    saying = sayings.get(error.validator)
    expected = error.schema["description"] if saying is None else saying()
    if isinstance(value, str) and reads_as_number(value) and error.validator != "enum":
        expected += f" ({_why_text(value)})"
    return place, "null" if value is None else repr(value), expected


def one_of(allowed: Iterable[str], unknown: object) -> str:
    """The expectation for an unknown name: one of the allowed names, those that resemble it
    first."""
    names = list(allowed)
    similar = get_close_matches(str(unknown), names, n=3)
    return "one of " + ", ".join([*similar, *(name for name in names if name not in similar)])


def _noun(types: str | list[str]) -> str:
    return " or ".join(NOUNS[kind] for kind in ([types] if isinstance(types, str) else types))


def _why_text(text: str) -> str:
    """Why a text that looks like a number is none."""
    if not isinstance(yaml.safe_load(text), int | float):
        return f"YAML reads {text} as text; write {yaml_number(text)}"
    return (
        "text here: without quotes it is a number in a file, but none within {} on a command line"
    )


def dotted(place: list) -> str:
    """Keys and indices as a person writes them: a.b[0]."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text or "top level"
