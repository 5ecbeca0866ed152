"""Effects found before, from which a search begins: each has to be borne out anew."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from eitskin import yaml_file
from eitskin.diagnose.candidates import Candidate
from eitskin.diagnose.fit import Problem
from eitskin.diagnose.search.screen import sparse
from eitskin.diagnose.search.state import State
from eitskin.effects.effect import Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError

PLACE = "twin.effects"  # of effects.yaml
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
    def at(cls, chosen: list[Setting], candidates: list[Candidate], problem: Problem) -> "Start":
        """Effects at given values, as candidates of a search have them, in a problem whose
        calibrations are as they are believed. InputError for one that none of the candidates can
        be."""
        effects, theta = [], [np.zeros(len(problem.model.calibrations))]
        for setting in chosen:
            candidate, coordinates = _candidate(setting, candidates)
            effects.append(candidate)
            theta.append(coordinates)
        return cls(effects, np.concatenate(theta))


def read(path: str | Path, channels: np.ndarray) -> list[Setting]:
    """The effects of an effects.yaml, for a recording of channels (M, 4). InputError for a file
    that has none, and for effects and sites that there are not."""
    twin = yaml_file.read(path).get("twin")
    items: Any = twin.get("effects") if isinstance(twin, dict) else None
    plain = isinstance(items, list) and all(isinstance(i, dict) and "name" in i for i in items)
    if not plain:
        raise InputError(path, PLACE, items, "the list of effects of an effects.yaml")
    try:
        return settings(items, site_counts(channels), (0, 0))
    except InputError as error:
        place = f"{PLACE}, {error.file}, {error.place}"
        raise InputError(path, place, error.found, error.expected) from error


def _candidate(setting: Setting, candidates: list[Candidate]) -> tuple[Candidate, np.ndarray]:
    """The candidate that can have a setting, of the fewest coordinates, those from which it is
    nearest, and these coordinates."""
    name, found = setting.effect.name, []
    for one in candidates:
        if one.name != name or one.kind != setting.kind:
            continue
        own = _at_sites(one, setting)
        if own is None:
            continue
        coordinates = own.coordinates(setting.values)
        if _has(own.setting(coordinates), setting, own):
            found.append((own.size, np.abs(coordinates).max(initial=0.0), own, coordinates))
    if not found:
        expected = "an effect that is sought in this recording, at values that it can have"
        raise InputError("effects", "of an earlier diagnosis", name, expected)
    *_, best, coordinates = min(found, key=lambda one: one[:2])
    return best, coordinates


def _at_sites(candidate: Candidate, setting: Setting) -> Candidate | None:
    """A candidate at a setting's sites: itself, or of one with a value at every site some; None
    where it is at others. A tone's has its frequency."""
    if candidate.effect.tone:
        candidate = replace(candidate, start={"frequency_Hz": setting.values["frequency_Hz"]})
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
