"""One recording's diagnosis held against its truth: names, sites, intervals.

An entry is an effect as diagnosis.json names it; a true effect is {name, sites, parameters}.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES

CLASS = 3.0  # gap below which names are one class: one test in 15 takes one for the other, Φ(-1.5)
TOO_FAR = 5.0  # gap above which an alternative is wrong: one in 160 is mistaken, Φ(-2.5)
GAIN = ("drive-gain", "measurement-gain", "channel-gain")  # dense: known up to a common factor


def next_gap(gaps: list | None) -> float:
    """Gap to the nearest name outside a true effect's class, of its (name, gap) pairs, nearest
    first; infinite where there is no other name, NaN where it is not known."""
    if gaps is None:
        return float("nan")
    beyond = [gap for _, gap in gaps if gap >= CLASS]
    return beyond[0] if beyond else (float("nan") if gaps else float("inf"))


def names_truth(entry: dict, true_name: str, gaps: list | None) -> bool:
    """Whether an entry is the true effect, by name or as one of a declared class: the true name
    is among its name and its alternatives, and none of these has a true gap over TOO_FAR."""
    declared = {entry["name"], *entry["alternatives"]}
    gap_of = dict(gaps or [])
    rivals = declared - {true_name}
    return true_name in declared and all(gap_of.get(n, np.inf) <= TOO_FAR for n in rivals)


def class_declared(entry: dict, true_name: str, gaps: list) -> bool:
    """Whether name and alternatives hold the whole class of the true effect."""
    true_class = {true_name, *(name for name, gap in gaps if gap < CLASS)}
    return true_class <= {entry["name"], *entry["alternatives"]}


def matched(row: dict) -> list[dict | None]:
    """For each true effect of a row the entry that names it, none twice."""
    free = list(row["said"]["effects"])
    entries: list[dict | None] = [None] * len(row["truth"])
    for by_name in (True, False):
        pairs = zip(row["truth"], row["true_gaps"], strict=True)
        for i, (true_effect, gaps) in enumerate(pairs):
            for entry in free:
                is_named = (entry["name"] == true_effect["name"]) == by_name
                if (
                    entries[i] is None
                    and is_named
                    and names_truth(entry, true_effect["name"], gaps)
                ):
                    entries[i] = entry
                    free.remove(entry)
                    break
    return entries


def site_kind(true_effect: dict) -> str | None:
    """The kind of a true effect's sites."""
    return next((kind for kind in SITES if kind in true_effect), None)


def sites_right(entry: dict, true_effect: dict) -> bool:
    """Whether an entry sits at the sites of a true effect that has some, and nowhere else."""
    kind = site_kind(true_effect)
    return sorted(entry[kind]) == sorted(true_effect[kind])


def finds_fault(harmed: dict, control: dict, fault: dict) -> bool:
    """Whether a diagnosis of the harmed excerpt finds the fault: it names it, or a class with it,
    at its sites and no others, and the one of the control does not.

    Channels that were lost are borne where nothing is named that the control does not name too.
    """
    if fault["name"] == "lost-channels":
        return not _entries(harmed) - _entries(control)
    return _names_fault(harmed, fault) and not _names_fault(control, fault)


def _names_fault(diagnosis: dict, fault: dict) -> bool:
    for entry in diagnosis["effects"]:
        if fault["name"] not in (entry["name"], *entry["alternatives"]):
            continue
        if site_kind(fault) is not None and not sites_right(entry, fault):
            continue
        clipped = "limit_V" in fault.get("parameters", {})
        if entry["name"] == fault["name"] and clipped and "limit_V" not in entry["parameters"]:
            continue
        return True
    return False


def _entries(diagnosis: dict) -> set[tuple]:
    """Names and sites of what a diagnosis names."""
    return {
        (entry["name"], *(tuple(entry[kind]) for kind in SITES)) for entry in diagnosis["effects"]
    }


@dataclass(frozen=True)
class Number:
    """One number of a true effect beside the estimate: which parameter, at which site; NaN where
    the entry does not hold it."""

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


def covered(entry: dict, true_effect: dict, scope: str) -> list[bool]:
    """Whether each of `numbers` lies in its interval."""
    return [number.inside for number in numbers(entry, true_effect, scope)]


def numbers(entry: dict, true_effect: dict, scope: str) -> list[Number]:
    """The parameters of a true effect beside those of the entry that has its name: one a number,
    at the true sites that are named.

    Angles count modulo their period; all are wrong where a whole number is; a law without the true
    one's parameter is wrong. Dense gains count after their common factor, which is the
    conductivity's. What the truth leaves open is not counted.
    """
    effect = EFFECTS[true_effect["name"]]
    polar, kind = effect.polar, site_kind(true_effect)
    places = [None] if kind is None else true_effect[kind] or [None]
    counted: list[Number] = []
    for key, true in true_effect.get("parameters", {}).items():
        parameter = effect.parameters[key]
        turns = polar[2] if polar is not None and key == polar[1] else None  # of an angle
        circular = turns is not None and true_effect["parameters"].get("harmonic") == 0
        if true is None or circular:
            continue
        if key not in entry["parameters"]:
            if np.any(np.asarray(true) != parameter.neutral):
                counted.append(_unknown(key, true))
            continue
        estimates = [_at(entry["parameters"][key], entry, kind, place) for place in places]
        true_values = np.broadcast_to(np.asarray(true, float), (len(estimates),))
        rows = [
            (place, value, *estimate)
            for place, value, estimate in zip(places, true_values, estimates, strict=True)
            if estimate
        ]
        if not rows:
            continue
        value, guess, low, high = np.array([row[1:] for row in rows], float).T
        if turns is not None:
            period = 360.0 / turns
            value = value + period * np.round((guess - value) / period)
        if true_effect["name"] in GAIN and scope == "dense":
            value = value / np.exp(np.median(np.log(value / guess)))
        if parameter.whole:
            if not ((low <= value) & (value <= high)).all():
                return _all_unknown(true_effect)
            continue
        columns = zip(rows, value, guess, low, high, strict=True)
        counted.extend(Number(key, row[0], *map(float, four)) for row, *four in columns)
    return counted


def _unknown(key: str, true: float | list[float]) -> Number:
    return Number(key, None, float(np.ravel(true)[0]), *(float("nan"),) * 3)


def _all_unknown(true_effect: dict) -> list[Number]:
    """Every number that a true effect's parameters are but whole ones, none estimated."""
    effect = EFFECTS[true_effect["name"]]
    return [
        _unknown(key, value)
        for key, values in true_effect["parameters"].items()
        if values is not None and not effect.parameters[key].whole
        for value in np.ravel(values)
    ]


def _at(estimate: dict, entry: dict, kind: str | None, place: int | None) -> tuple | None:
    """(value, low, high) of an entry's parameter at a site, None where it says nothing of it."""
    parts = tuple(estimate[part] for part in ("value", "low", "high"))
    sites = entry[kind] if kind is not None else []
    if np.ndim(parts[0]) == 0:
        everywhere = not any(entry[any_kind] for any_kind in SITES)
        return parts if everywhere or place is None or place in sites else None
    if place is None:
        return tuple(float(np.median(part)) for part in parts)
    index = sites.index(place) if place in sites else None
    return None if index is None else tuple(part[index] for part in parts)
