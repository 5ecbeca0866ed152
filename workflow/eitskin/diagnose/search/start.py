"""Effects found before, from which a search begins: each has to be borne out anew."""

from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from eitskin import yaml_file
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.channel_mapping import NAMED_BY
from eitskin.diagnose.fitting.fit import Problem
from eitskin.diagnose.search import tones
from eitskin.diagnose.search.screen import sparse
from eitskin.diagnose.search.state import State
from eitskin.effects.effect import SITES, Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table

PROTOCOL, PLACE = "twin.protocol", "twin.effects"  # of effects.yaml
SAME = 1e-6  # of a typical change: so near a value, a candidate has it


@dataclass(frozen=True)
class Start:
    """A set of effects and where their fit begins: theta (P,) the calibrations' coordinates, then
    each effect's; p_values: by keys, of effects that were held to chance before."""

    effects: list[Candidate]
    theta: np.ndarray
    p_values: dict[tuple, float] = field(default_factory=dict)

    @classmethod
    def of(cls, state: State) -> "Start":
        """What was found on fewer frames."""
        return cls(state.effects, state.fit.theta, state.p_values)

    @classmethod
    def at(
        cls, chosen: list[Setting], candidates: list[Candidate], problem: Problem
    ) -> "Start | None":
        """Effects at given values, as candidates of a search have them, in a problem whose
        calibrations are as they are believed; None where none of the candidates can be one of
        them."""
        effects, theta = [], [np.zeros(len(problem.model.calibrations))]
        for setting in chosen:
            found = _candidate(setting, candidates, problem)
            if found is None:
                return None
            effects.append(found[0])
            theta.append(found[1])
        return cls(effects, np.concatenate(theta))


def read(path: str | Path, channels: np.ndarray) -> list[Setting]:
    """The effects of an effects.yaml, for a recording of channels (M, 4).

    InputError for a file that has none, for effects and sites that there are not, and for drives,
    pairs or channels of another table.
    """
    twin: Any = yaml_file.read(path).get("twin")
    items = twin.get("effects") if isinstance(twin, dict) else None
    if not isinstance(items, list):
        raise InputError(path, PLACE, items, "the list of effects of an effects.yaml")
    for number, item in enumerate(items):
        for place, found, expected in _wrong(item):
            raise InputError(path, f"{PLACE}[{number}]{place}", found, expected)
    try:
        chosen = settings(items, site_counts(channels), (0, 0))
    except InputError as error:
        place = f"{PLACE}, {error.file}, {error.place}"
        raise InputError(path, place, error.actual, error.expected) from error
    protocol = twin.get("protocol", {})
    if any(one.kind in NAMED_BY for one in chosen) and not _makes(protocol, channels):
        expected = "what makes the recording's channels, as effects are at some of them"
        raise InputError(path, PROTOCOL, protocol, expected)
    return chosen


def _wrong(item: Any) -> list[tuple[str, Any, str]]:
    """What an item of the list has that effects.yaml does not write: place, found, expected."""
    if not isinstance(item, dict) or not isinstance(item.get("name"), str):
        return [("", item, "an effect: a mapping with a name")]
    found: list[tuple[str, Any, str]] = []
    for key, value in item.items():
        if key in SITES:
            whole = isinstance(value, list) and all(type(site) is int for site in value)
            if not whole or not value:
                found.append((f".{key}", value, "a list of whole numbers"))
        elif key == "parameters":
            given = value.items() if isinstance(value, dict) else []
            if not isinstance(value, dict):
                found.append((f".{key}", value, "a mapping, parameter: value"))
            for name, one in given:
                if not all(_number(part) for part in (one if isinstance(one, list) else [one])):
                    found.append((f".{key}.{name}", one, "a number, or a list of one a site"))
        elif key != "name":
            found.append(("", key, f"name, parameters or one of {', '.join(SITES)}"))
    return found


def _number(value: Any) -> bool:
    return value is None or (isinstance(value, Real) and not isinstance(value, bool))


def _makes(protocol: Any, channels: np.ndarray) -> bool:
    """Whether a protocol, as the configuration has it, makes this table of channels (M, 4)."""
    try:
        table = channel_table(int(channels.max()) + 1, **protocol)
    except (InputError, TypeError, ValueError):
        return False
    return np.array_equal(table, channels)


def _candidate(
    setting: Setting, candidates: list[Candidate], problem: Problem
) -> tuple[Candidate, np.ndarray] | None:
    """The candidate that can have a setting, of the fewest coordinates, those from which it is
    nearest, and these coordinates; None where there is none."""
    found = []
    for one in candidates:
        if one.name != setting.effect.name or one.kind != setting.kind:
            continue
        own = _at_sites(one, setting, problem)
        if own is None:
            continue
        coordinates = own.coordinates(setting.values)
        if _has(own.setting(coordinates), setting, own):
            found.append((own.size, np.abs(coordinates).max(initial=0.0), own, coordinates))
    if not found:
        return None
    *_, best, coordinates = min(found, key=lambda one: one[:2])
    return best, coordinates


def _at_sites(candidate: Candidate, setting: Setting, problem: Problem) -> Candidate | None:
    """A candidate at a setting's sites: itself, or of one with a value at every site some; None
    where it is at others. A tone's has its frequency."""
    if candidate.effect.tone:
        candidate = tones.at(candidate, setting.values["frequency_Hz"], problem.model)
    if setting.sites is None:
        return candidate
    sites = tuple(int(site) for site in setting.sites)
    if candidate.sites == sites:
        return candidate
    return sparse(candidate, sites) if candidate.scope == "dense" else None


def _has(there: Setting, setting: Setting, candidate: Candidate) -> bool:
    """Whether a candidate's setting has the values that are wanted; what it leaves to a recording
    is no value."""
    effect, polar = candidate.effect, candidate.effect.polar
    left_open = effect.recorded_values(0.0)
    for key, value in there.values.items():
        wanted = setting.values[key]
        if value is None or wanted is None:
            if value is wanted or key in left_open:
                continue
            return False
        off = np.asarray(value, float) - np.asarray(wanted, float)
        if polar and key == polar[1]:
            off = (off + 180.0 / polar[2]) % (360.0 / polar[2]) - 180.0 / polar[2]
        scale = candidate.scales.of(effect.parameters[key])
        if np.any(np.abs(off) > SAME * max(scale, np.abs(wanted).max(initial=0.0))):
            return False
    return True
