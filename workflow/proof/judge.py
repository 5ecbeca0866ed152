"""One recording's diagnosis held against its truth: names, sites, intervals."""

from dataclasses import dataclass

import numpy as np

from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES

CLASS = 3.0  # names with a gap under it are one class
TOO_FAR = 5.0  # an alternative with a true gap over it is wrong
GAIN = ("drive-gain", "measurement-gain", "channel-gain")  # dense: known up to a common factor


def next_gap(gaps: list | None) -> float:
    """Gap to the nearest name outside a true effect's class, of its (name, gap) pairs, nearest
    first; infinite where there is no other name, NaN where it is not known."""
    if gaps is None:
        return float("nan")
    beyond = [gap for _, gap in gaps if gap >= CLASS]
    return beyond[0] if beyond else (float("nan") if gaps else float("inf"))


def names_truth(found: dict, true_name: str, gaps: list | None) -> bool:
    """Whether a found effect is the true one, by name or as one of a declared class: the true name
    is among its name and its alternatives, and no other of them has a true gap over TOO_FAR."""
    declared = {found["name"], *found["alternatives"]}
    apart = dict(gaps or [])
    others = declared - {true_name}
    return true_name in declared and all(apart.get(n, np.inf) <= TOO_FAR for n in others)


def class_declared(found: dict, true_name: str, gaps: list) -> bool:
    """Whether name and alternatives hold the whole class of the true effect."""
    whole = {true_name, *(name for name, gap in gaps if gap < CLASS)}
    return whole <= {found["name"], *found["alternatives"]}


def matched(row: dict) -> list[dict | None]:
    """For each true effect of a row the found one that names it, none twice."""
    free = list(row["said"]["effects"])
    of: list[dict | None] = [None] * len(row["truth"])
    for by_name in (True, False):
        for i, (item, gaps) in enumerate(zip(row["truth"], row["true_gaps"], strict=True)):
            for found in free:
                same = found["name"] == item["name"]
                if of[i] is None and same == by_name and names_truth(found, item["name"], gaps):
                    of[i] = found
                    free.remove(found)
                    break
    return of


def site_kind(item: dict) -> str | None:
    """The kind of a true effect's sites."""
    return next((kind for kind in SITES if kind in item), None)


def sites_right(found: dict, item: dict) -> bool:
    """Whether a found effect sits at the sites of a true one that has some, and at no others."""
    kind = site_kind(item)
    return sorted(found[kind]) == sorted(item[kind])


@dataclass(frozen=True)
class Number:
    """One number of a true effect beside the found one: which parameter and site; NaN where the
    found effect does not tell it."""

    key: str
    place: int | None
    true: float
    value: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the interval holds the truth."""
        return bool(self.low <= self.true <= self.high)


def covered(found: dict, item: dict, scope: str) -> list[bool]:
    """Whether each of `numbers` lies in its interval."""
    return [number.inside for number in numbers(found, item, scope)]


def numbers(found: dict, item: dict, scope: str) -> list[Number]:
    """The parameters of a true effect beside those of the found one, which has its name: one entry
    a number, at the true sites that were found.

    Angles count modulo their period; all are wrong where a whole number is; a law without the true
    one's parameter is wrong. Dense gains count after their common factor, which is the
    conductivity's. What the truth leaves open is not counted.
    """
    effect = EFFECTS[item["name"]]
    polar, kind = effect.polar, site_kind(item)
    places = None if kind is None else item[kind]
    told: list[Number] = []
    for key, true in item.get("parameters", {}).items():
        parameter = effect.parameters[key]
        turns = polar[2] if polar is not None and key == polar[1] else None  # of an angle
        if true is None or (turns is not None and item["parameters"].get("harmonic") == 0):
            continue
        if key not in found["parameters"]:
            if np.any(np.asarray(true) != parameter.neutral):
                told.append(_untold(key, true))
            continue
        given = found["parameters"][key]
        asked = places or [None]
        at = [_at(given, found, kind, place) for place in asked]
        values = np.broadcast_to(np.asarray(true, float), (len(at),))
        known = [(place, v, *one) for place, v, one in zip(asked, values, at, strict=True) if one]
        if not known:
            continue
        value, guess, low, high = np.array([one[1:] for one in known], float).T
        if turns is not None:
            period = 360.0 / turns
            value = value + period * np.round((guess - value) / period)
        if item["name"] in GAIN and scope == "dense":
            value = value / np.exp(np.median(np.log(value / guess)))
        if parameter.whole:
            if not ((low <= value) & (value <= high)).all():
                return _all_untold(item)
            continue
        rows = zip(known, value, guess, low, high, strict=True)
        told.extend(Number(key, one[0], *map(float, four)) for one, *four in rows)
    return told


def _untold(key: str, true: float | list[float]) -> Number:
    nothing = float("nan")
    return Number(key, None, float(np.ravel(true)[0]), nothing, nothing, nothing)


def _all_untold(item: dict) -> list[Number]:
    """Every number that a true effect's parameters are, whole ones not counted, told by none."""
    effect = EFFECTS[item["name"]]
    kept = {k: v for k, v in item["parameters"].items() if not effect.parameters[k].whole}
    return [_untold(k, one) for k, v in kept.items() if v is not None for one in np.ravel(v)]


def _at(given: dict, found: dict, kind: str | None, place: int | None) -> tuple | None:
    """(value, low, high) of a found parameter at a site, None where it says nothing of it."""
    parts = tuple(given[part] for part in ("value", "low", "high"))
    there = found[kind] if kind is not None else []
    if np.ndim(parts[0]) == 0:
        everywhere = not any(found[any_kind] for any_kind in SITES)
        return parts if everywhere or place is None or place in there else None
    if place is None:
        return tuple(float(np.median(part)) for part in parts)
    index = there.index(place) if place in there else None
    return None if index is None else tuple(part[index] for part in parts)
