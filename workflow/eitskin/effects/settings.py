"""Effects at definite values from the effects of a configuration."""

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


def settings(effects: list[dict], counts: dict[str, int], draw: tuple[int, ...]) -> list[Setting]:
    """Effects at definite values; random parameters by the seed sequence `draw` (seed, session
    ...).

    effects: blocks {name, [electrodes, drives, measures or channels], parameters}; a parameter is a
    number, a list with one number a site, {sd, [mean], [tie: mirror]}, or null, the neutral value.
    counts: number of sites of each kind. Equal seeds give equal standard normals, for any sd.
    Raises InputError for unknown names, sites or parameters and values out of bounds.
    """
    return [_setting(block, counts, (*draw, position)) for position, block in enumerate(effects)]


def _setting(block: dict, counts: dict[str, int], draw: tuple[int, ...]) -> Setting:
    name = block["name"]
    if name not in EFFECTS:
        raise InputError("effects", "name", repr(name), f"one of {sorted(EFFECTS)}")
    effect = EFFECTS[name]
    place = f"effect {name}"
    kind, sites = _sites(block, effect, counts, place)
    parameters = block.get("parameters", {})
    for key in parameters:
        if key not in effect.parameters:
            expected = f"one of {sorted(effect.parameters)}"
            raise InputError(place, "parameters", repr(key), expected)
    values = {}
    for key, parameter in effect.parameters.items():
        size = None if sites is None or not parameter.dense else len(sites)
        seed = (*draw, zlib.crc32(f"{name}.{key}".encode()))
        value = parameter.neutral if parameters.get(key) is None else parameters[key]
        values[key] = _value(value, parameter, size, place, key, seed)
    return Setting(effect, sites, values, kind)


def _sites(
    block: dict, effect: Effect, counts: dict[str, int], place: str
) -> tuple[str | None, np.ndarray | None]:
    """The kind of site and the indices; by default all sites of the effect's first kind."""
    kinds = [kind for kind in SITES if block.get(kind)]
    for kind in kinds:
        if kind not in effect.sites or len(kinds) > 1:
            expected = " or ".join(effect.sites) or "no sites"
            raise InputError(place, kind, block[kind], expected)
    if not effect.sites:
        return None, None
    kind = kinds[0] if kinds else effect.sites[0]
    count = counts[kind]
    sites = np.array(block.get(kind) or range(count), dtype=int)
    if sites.min() < 0 or sites.max() >= count or len(set(sites.tolist())) < len(sites):
        raise InputError(place, kind, sites.tolist(), f"indices 0 to {count - 1}, once")
    if effect.site_number not in (None, len(sites)):
        actual = f"{len(sites)} of them"
        raise InputError(place, kind, actual, f"{effect.site_number}")
    return kind, sites


def _value(
    stated: Any, parameter: Parameter, size: int | None, place: str, key: str, seed: tuple
) -> np.ndarray | float | None:
    if stated is None:
        if not parameter.optional:
            raise InputError(place, key, "nothing", f"a value in {parameter.unit}")
        return None
    if isinstance(stated, dict):
        mean = stated.get("mean", parameter.neutral)
        if mean is None:
            raise InputError(place, key, stated, "a mean beside the sd")
        normal = np.random.default_rng(seed).standard_normal(size)
        if stated.get("tie") == "mirror":
            if size is None:
                raise InputError(place, key, "tie: mirror", "a parameter with sites")
            half = size // 2
            normal[size - half :] = normal[:half][::-1]
        value = mean + stated["sd"] * normal
    else:
        value = np.asarray(stated, dtype=float)
        if value.ndim and value.shape != (size,):
            raise InputError(place, key, f"{len(value)} values", f"one, or one a site ({size})")
        value = value if value.ndim else float(value)
    low, high = np.min(value), np.max(value)
    if not (low >= parameter.low and high <= parameter.high):
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        expected = f"{parameter.low:g} to {parameter.high:g}{unit}"
        actual = f"{low:g}" if low == high else f"{low:g} to {high:g}"
        raise InputError(place, key, actual, expected)
    return value
