"""From an effect as the configuration writes it to one at definite values."""

import zlib
from typing import Any

import numpy as np

from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES, Effect, Parameter, Setting
from eitskin.errors import InputError


def site_counts(channels: np.ndarray) -> dict[str, int]:
    """How many electrodes, drives, measures and channels a channel table has."""
    n = int(channels.max()) + 1
    return {"electrodes": n, "drives": n, "measures": n, "channels": len(channels)}


def settings(items: list[dict], counts: dict[str, int], draw: tuple[int, ...]) -> list[Setting]:
    """Effects at definite values, drawn parameters by the seed sequence `draw` (seed, session ...).

    items: {name, [electrodes, drives, measures or channels], parameters}; a parameter is a number,
    a list with one number a site, {sd, [mean], [tie: mirror]}, or null: the neutral one. counts:
    how many of each kind of site there are. Equal seeds give equal standard normals, whatever
    their sd. Raises InputError for unknown names, sites or parameters and values out of bounds.
    """
    return [_setting(item, counts, (*draw, position)) for position, item in enumerate(items)]


def _setting(item: dict, counts: dict[str, int], draw: tuple[int, ...]) -> Setting:
    name = item["name"]
    if name not in EFFECTS:
        raise InputError("effects", "name", repr(name), f"one of {sorted(EFFECTS)}")
    effect = EFFECTS[name]
    place = f"effect {name}"
    kind, sites = _sites(item, effect, counts, place)
    given = item.get("parameters", {})
    for key in given:
        if key not in effect.parameters:
            expected = f"one of {sorted(effect.parameters)}"
            raise InputError(place, "parameters", repr(key), expected)
    values = {}
    for key, parameter in effect.parameters.items():
        size = None if sites is None or not parameter.dense else len(sites)
        seed = (*draw, zlib.crc32(f"{name}.{key}".encode()))
        value = parameter.neutral if given.get(key) is None else given[key]
        values[key] = _value(value, parameter, size, place, key, seed)
    return Setting(effect, sites, values, kind)


def _sites(
    item: dict, effect: Effect, counts: dict[str, int], place: str
) -> tuple[str | None, np.ndarray | None]:
    """The kind of site and the indices; all of the effect's first kind where none are given."""
    named = [kind for kind in SITES if item.get(kind)]
    for kind in named:
        if kind not in effect.sites or len(named) > 1:
            expected = " or ".join(effect.sites) or "no sites"
            raise InputError(place, kind, item[kind], expected)
    if not effect.sites:
        return None, None
    kind = named[0] if named else effect.sites[0]
    count = counts[kind]
    sites = np.array(item.get(kind) or range(count), dtype=int)
    if sites.min() < 0 or sites.max() >= count or len(set(sites.tolist())) < len(sites):
        raise InputError(place, kind, sites.tolist(), f"indices 0 to {count - 1}, once")
    if effect.site_number not in (None, len(sites)):
        found = f"{len(sites)} of them"
        raise InputError(place, kind, found, f"{effect.site_number}")
    return kind, sites


def _value(
    given: Any, parameter: Parameter, size: int | None, place: str, key: str, seed: tuple
) -> np.ndarray | float | None:
    if given is None:
        if not parameter.optional:
            raise InputError(place, key, "nothing", f"a value in {parameter.unit}")
        return None
    if isinstance(given, dict):
        mean = given.get("mean", parameter.neutral)
        if mean is None:
            raise InputError(place, key, given, "a mean beside the sd")
        normal = np.random.default_rng(seed).standard_normal(size)
        if given.get("tie") == "mirror":
            if size is None:
                raise InputError(place, key, "tie: mirror", "a parameter with sites")
            half = size // 2
            normal[size - half :] = normal[:half][::-1]
        value = mean + given["sd"] * normal
    else:
        value = np.asarray(given, dtype=float)
        if value.ndim and value.shape != (size,):
            raise InputError(place, key, f"{len(value)} values", f"one, or one a site ({size})")
        value = value if value.ndim else float(value)
    low, high = np.min(value), np.max(value)
    if not (low >= parameter.low and high <= parameter.high):
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        expected = f"{parameter.low:g} to {parameter.high:g}{unit}"
        found = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        raise InputError(place, key, found, expected)
    return value
