"""Whether a document is a diagnosis: what the contract requires, and what no schema can say."""

from pathlib import Path

import numpy as np
import yaml

from eitskin.effects import EFFECTS, catalogue_names
from eitskin.effects.effect import SITES, Effect
from eitskin.errors import InputError
from eitskin.schema import Validator, explained

NO_SITES = {"maxItems": 0, "description": "no sites"}


def schema(path: str | Path) -> dict:
    """The schema in a file, with the catalogue's names and what each requires of sites, driver and
    parameters."""
    content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    names = catalogue_names()
    content["$defs"]["name"]["enum"] = names
    content["$defs"]["effect"]["allOf"] = [
        {
            "if": {"properties": {"name": {"const": name}}},
            "then": {"allOf": [_site_rules(EFFECTS[name]), _value_rules(EFFECTS[name])]},
        }
        for name in names
    ]
    return content


def _site_rules(effect: Effect) -> dict:
    """No sites of other kinds than the effect's, of these none where it is common; its number where
    it has one. Drives and pairs that no electrode identifies are given by their channels.
    """
    kinds = list(effect.sites)
    if {"drives", "measures"} & {*kinds} and "channels" not in kinds:
        kinds.append("channels")
    rules = {kind: NO_SITES for kind in SITES if kind not in kinds}
    if not kinds:
        rules["scope"] = {"const": "common", "description": "common, for it has no sites"}
        return {"properties": rules}
    any_sites = [{"properties": {kind: {"minItems": 1}}} for kind in kinds]
    if effect.site_number:
        description = f"sparse, for it has {effect.site_number} sites"
        rules["scope"] = {"const": "sparse", "description": description}
        number = {"minItems": effect.site_number, "maxItems": effect.site_number}
        any_sites = [{"properties": {kind: number}} for kind in kinds]
    return {
        "properties": rules,
        "if": {"properties": {"scope": {"const": "common"}}},
        "then": {"properties": dict.fromkeys(kinds, NO_SITES)},
        "else": any_sites[0]
        if len(any_sites) == 1
        else {"anyOf": any_sites, "description": " or ".join(kinds)},
    }


def _value_rules(effect: Effect) -> dict:
    """The effect's driver; its parameters with their units, of `either` one."""
    rules = {
        key: {
            "$ref": "#/$defs/estimate",
            "properties": {
                "unit": {"const": parameter.unit, "description": f"the unit {parameter.unit}"}
            },
        }
        for key, parameter in effect.parameters.items()
    }
    required = [key for key, p in effect.parameters.items() if not p.optional]
    parameters = {"additionalProperties": False, "required": required, "properties": rules}
    if effect.either:
        parameters["description"] = " or ".join(effect.either)
        parameters["minProperties"] = len(required) + 1
        parameters["maxProperties"] = len(rules) - len(effect.either) + 1
    driver = {"const": effect.driver, "description": effect.driver}
    properties = {"driver": driver, "parameters": parameters}
    if effect.combination is None:
        properties["amounts"] = {"maxProperties": 0, "description": "none"}
    return {"properties": properties}


def validate(document: dict, schema_path: str | Path, file: str | Path) -> None:
    """Raise InputError, with `file` as its place, unless a document is a diagnosis.

    Beyond the schema: an interval holds its value, or of the noise its `sd`; a list has one number
    a site, and an effect is no alternative to itself.
    """
    errors = sorted(
        Validator(schema(schema_path)).iter_errors(document), key=lambda error: len(error.path)
    )
    if errors:
        path, actual, expected = explained(errors[0])
        place = errors[0].json_path.removeprefix("$.")
        if len(path) > len(errors[0].absolute_path):
            place = f"{place}.{path[-1]}".removeprefix("$.")
        raise InputError(file, place, actual, expected)
    for key, estimate in document["calibration"].items():
        _check_estimate(estimate, file, f"calibration.{key}")
    for k, component in enumerate(document.get("noise", {}).get("components", [])):
        _check_estimate(component, file, f"noise.components[{k}]", "sd")
    for k, effect in enumerate(document["effects"]):
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


def _check_estimate(estimate: dict, file: str | Path, place: str, key: str = "value") -> None:
    """Raise InputError unless the number at `key` lies within the interval, shape by shape."""
    low, value, high = (np.asarray(estimate[name], float) for name in ("low", key, "high"))
    if not low.shape == value.shape == high.shape:
        actual = f"shapes {low.shape}, {value.shape}, {high.shape}"
        raise InputError(file, place, actual, f"low, {key} and high of one shape")
    shape = np.shape(estimate.get("at_bound", value))
    if shape != value.shape:
        raise InputError(file, f"{place}.at_bound", f"shape {shape}", "one a value")
    if not ((low <= value) & (value <= high)).all():
        actual = f"{key} {estimate[key]}, low {estimate['low']}, high {estimate['high']}"
        raise InputError(file, place, actual, f"low ≤ {key} ≤ high")
