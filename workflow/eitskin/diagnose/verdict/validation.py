"""Whether a diagnosis is one: what the contract asks of it, and what no schema can say."""

from pathlib import Path

import numpy as np
import yaml

from eitskin.effects import EFFECTS, catalogue_names
from eitskin.effects.effect import SITES, Effect
from eitskin.errors import InputError
from eitskin.schema import Validator, explained

NO_SITES = {"maxItems": 0, "description": "no sites"}


def schema(path: str | Path) -> dict:
    """The schema in a file, with the catalogue's names and what each asks of its sites, its driver
    and its parameters."""
    found = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    names = catalogue_names()
    found["$defs"]["name"]["enum"] = names
    found["$defs"]["effect"]["allOf"] = [
        {
            "if": {"properties": {"name": {"const": name}}},
            "then": {"allOf": [_sites(EFFECTS[name]), _values(EFFECTS[name])]},
        }
        for name in names
    ]
    return found


def _sites(effect: Effect) -> dict:
    """No sites of other kinds than the effect's, of its own none where they are common; its number
    where it has one. Drives and pairs that their electrode does not tell stand by their channels.
    """
    own = list(effect.sites)
    if {"drives", "measures"} & {*own} and "channels" not in own:
        own.append("channels")
    rules = {kind: NO_SITES for kind in SITES if kind not in own}
    if not own:
        rules["scope"] = {"const": "common", "description": "common, for it has no sites"}
        return {"properties": rules}
    some = [{"properties": {kind: {"minItems": 1}}} for kind in own]
    if effect.site_number:
        said = f"sparse, for it has {effect.site_number} sites"
        rules["scope"] = {"const": "sparse", "description": said}
        number = {"minItems": effect.site_number, "maxItems": effect.site_number}
        some = [{"properties": {kind: number}} for kind in own]
    return {
        "properties": rules,
        "if": {"properties": {"scope": {"const": "common"}}},
        "then": {"properties": dict.fromkeys(own, NO_SITES)},
        "else": some[0] if len(some) == 1 else {"anyOf": some, "description": " or ".join(own)},
    }


def _values(effect: Effect) -> dict:
    """The effect's driver; its parameters with their units, of `either` one."""
    rules = {
        key: {
            "$ref": "#/$defs/estimate",
            "properties": {"unit": {"const": one.unit, "description": f"the unit {one.unit}"}},
        }
        for key, one in effect.parameters.items()
    }
    needed = [key for key, one in effect.parameters.items() if not one.optional]
    parameters = {"additionalProperties": False, "required": needed, "properties": rules}
    if effect.either:
        parameters["description"] = " or ".join(effect.either)
        parameters["minProperties"] = len(needed) + 1
        parameters["maxProperties"] = len(rules) - len(effect.either) + 1
    driver = {"const": effect.driver, "description": effect.driver}
    found = {"driver": driver, "parameters": parameters}
    if effect.combination is None:
        found["amounts"] = {"maxProperties": 0, "description": "none"}
    return {"properties": found}


def validate(result: dict, schema_path: str | Path, file: str | Path) -> None:
    """Raise InputError, with `file` as its place, unless `result` is a diagnosis.

    Beyond the schema: an interval holds its value, or of the noise its `sd`; a list has one number
    a site, and an effect is no alternative to itself.
    """
    errors = sorted(
        Validator(schema(schema_path)).iter_errors(result), key=lambda error: len(error.path)
    )
    if errors:
        at, found, expected = explained(errors[0])
        named = errors[0].json_path.removeprefix("$.")
        if len(at) > len(errors[0].absolute_path):
            named = f"{named}.{at[-1]}".removeprefix("$.")
        raise InputError(file, named, found, expected)
    for key, estimate in result["calibration"].items():
        _check_estimate(estimate, file, f"calibration.{key}")
    for k, component in enumerate(result.get("noise", {}).get("components", [])):
        _check_estimate(component, file, f"noise.components[{k}]", "sd")
    for k, effect in enumerate(result["effects"]):
        if effect["name"] in effect["alternatives"]:
            place = f"effects[{k}].alternatives"
            raise InputError(file, place, f"{effect['name']!r}", "names other than its own")
        sites = max(len(effect[kind]) for kind in SITES)
        for key, estimate in effect["parameters"].items():
            place = f"effects[{k}].parameters.{key}"
            _check_estimate(estimate, file, place)
            size = np.size(estimate["value"])
            if isinstance(estimate["value"], list) and size != sites:
                raise InputError(file, place, f"{size} values", f"one a site ({sites})")
        for key, amount in effect.get("amounts", {}).items():
            _check_estimate(amount, file, f"effects[{k}].amounts.{key}")


def _check_estimate(estimate: dict, file: str | Path, place: str, at: str = "value") -> None:
    """at: the key of what lies within the interval."""
    low, value, high = (np.asarray(estimate[key], float) for key in ("low", at, "high"))
    if not low.shape == value.shape == high.shape:
        found = f"shapes {low.shape}, {value.shape}, {high.shape}"
        raise InputError(file, place, found, f"low, {at} and high of one shape")
    ended = np.shape(estimate.get("at_bound", value))
    if ended != value.shape:
        raise InputError(file, f"{place}.at_bound", f"shape {ended}", "one a value")
    if not ((low <= value) & (value <= high)).all():
        found = f"{at} {estimate[at]}, low {estimate['low']}, high {estimate['high']}"
        raise InputError(file, place, found, f"low ≤ {at} ≤ high")
