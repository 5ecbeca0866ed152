"""Whether a diagnosis is one: what the contract asks of it, and what no schema can say."""

from pathlib import Path

import numpy as np
import yaml

from eitskin.effects.effect import SITES
from eitskin.errors import InputError
from eitskin.schema import Validator, explained


def validate(result: dict, schema: str | Path, file: str | Path) -> None:
    """Raise InputError, with `file` as its place, unless `result` is a diagnosis.

    Beyond the schema: an interval holds its value, a list has one number a site, and an effect is
    no alternative to itself.
    """
    rules = yaml.safe_load(Path(schema).read_text(encoding="utf-8"))
    errors = sorted(Validator(rules).iter_errors(result), key=lambda error: len(error.path))
    if errors:
        place, found, expected = explained(errors[0])
        named = errors[0].json_path.removeprefix("$.")
        if len(place) > len(errors[0].absolute_path):
            named = f"{named}.{place[-1]}".removeprefix("$.")
        raise InputError(file, named, found, expected)
    for key, estimate in result["calibration"].items():
        _check_estimate(estimate, file, f"calibration.{key}")
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


def _check_estimate(estimate: dict, file: str | Path, place: str) -> None:
    low, value, high = (np.asarray(estimate[key], float) for key in ("low", "value", "high"))
    if not low.shape == value.shape == high.shape:
        found = f"shapes {low.shape}, {value.shape}, {high.shape}"
        raise InputError(file, place, found, "low, value and high of one shape")
    if not ((low <= value) & (value <= high)).all():
        found = f"value {estimate['value']}, low {estimate['low']}, high {estimate['high']}"
        raise InputError(file, place, found, "low ≤ value ≤ high")
