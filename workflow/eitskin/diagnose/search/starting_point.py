"""Effects from which a search begins: each has to be borne out anew."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from eitskin import yaml_file
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.channel_mapping import SITE_COLUMNS
from eitskin.diagnose.fitting.fit import Problem
from eitskin.diagnose.search import tones
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.screen import sparse
from eitskin.effects.effect import SITES, Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table

PROTOCOL, PLACE = "twin.protocol", "twin.effects"  # of effects.yaml
TOLERANCE = 1e-6  # of a typical change, within which a candidate has a stated value


@dataclass(frozen=True)
class StartingPoint:
    """A set of effects and where their fit begins: theta (P,) the calibrations' coordinates, then
    each effect's; p_values: global, by the candidates' keys, where chance was asked before."""

    effects: list[Candidate]
    theta: np.ndarray
    p_values: Mapping[tuple, float] = field(default_factory=dict)

    @classmethod
    def from_explanation(cls, explanation: Explanation) -> "StartingPoint":
        """The effects of an explanation of fewer frames."""
        return cls(explanation.effects, explanation.fit.theta, explanation.p_values)

    @classmethod
    def from_settings(
        cls, stated: list[Setting], candidates: list[Candidate], problem: Problem
    ) -> "StartingPoint | None":
        """Stated effects at their values, as candidates of a search, in a problem whose
        calibrations are as they are believed; None where no candidate can be one of them."""
        effects, theta = [], [np.zeros(len(problem.model.calibrations))]
        for setting in stated:
            match = _matching(setting, candidates, problem)
            if match is None:
                return None
            effects.append(match[0])
            theta.append(match[1])
        return cls(effects, np.concatenate(theta))


def read(path: str | Path, channels: np.ndarray) -> list[Setting]:
    """The effects of an effects.yaml, for a recording of channels (M, 4).

    Raises InputError for a file that has none, for effects and sites that do not exist, and for
    drives, pairs or channels of another table.
    """
    twin: Any = yaml_file.read(path).get("twin")
    items = twin.get("effects") if isinstance(twin, dict) else None
    if not isinstance(items, list):
        raise InputError(path, PLACE, items, "the list of effects of an effects.yaml")
    for number, item in enumerate(items):
        for place, value, expected in _faults(item):
            raise InputError(path, f"{PLACE}[{number}]{place}", value, expected)
    try:
        stated = settings(items, site_counts(channels), (0, 0))
    except InputError as error:
        place = f"{PLACE}, {error.file}, {error.place}"
        raise InputError(path, place, error.actual, error.expected) from error
    protocol = twin.get("protocol", {})
    if any(setting.kind in SITE_COLUMNS for setting in stated) and not _makes(protocol, channels):
        expected = "what makes the recording's channels, as effects are at some of them"
        raise InputError(path, PROTOCOL, protocol, expected)
    return stated


def _faults(item: Any) -> list[tuple[str, Any, str]]:
    """What an item of the list has that effects.yaml does not write: place, value, expected."""
    if not isinstance(item, dict) or not isinstance(item.get("name"), str):
        return [("", item, "an effect: a mapping with a name")]
    faults: list[tuple[str, Any, str]] = []
    for key, value in item.items():
        if key in SITES:
            is_list = isinstance(value, list) and all(type(site) is int for site in value)
            if not is_list or not value:
                faults.append((f".{key}", value, "a list of whole numbers"))
        elif key == "parameters":
            if not isinstance(value, dict):
                faults.append((f".{key}", value, "a mapping, parameter: value"))
                continue
            for name, parameter in value.items():
                parts = parameter if isinstance(parameter, list) else [parameter]
                if not all(_is_number(part) for part in parts):
                    expected = "a number, or a list of one a site"
                    faults.append((f".{key}.{name}", parameter, expected))
        elif key != "name":
            faults.append(("", key, f"name, parameters or one of {', '.join(SITES)}"))
    return faults


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, Real) and not isinstance(value, bool))


def _makes(protocol: Any, channels: np.ndarray) -> bool:
    """Whether a protocol, as the configuration has it, makes this table of channels (M, 4)."""
    try:
        table = channel_table(int(channels.max()) + 1, **protocol)
    except (InputError, TypeError, ValueError):
        return False
    return np.array_equal(table, channels)


def _matching(
    setting: Setting, candidates: list[Candidate], problem: Problem
) -> tuple[Candidate, np.ndarray] | None:
    """The candidate that can have a setting, of the fewest coordinates, those from which it is
    nearest, and these coordinates; None where there is none."""
    matches = []
    for candidate in candidates:
        if candidate.name != setting.effect.name or candidate.kind != setting.kind:
            continue
        placed = _at_sites(candidate, setting, problem)
        if placed is None:
            continue
        coordinates = placed.coordinates(setting.values)
        if _agrees(placed.setting(coordinates), setting, placed):
            distance = np.abs(coordinates).max(initial=0.0)
            matches.append((placed.size, distance, placed, coordinates))
    if not matches:
        return None
    *_, best, coordinates = min(matches, key=lambda match: match[:2])
    return best, coordinates


def _at_sites(candidate: Candidate, setting: Setting, problem: Problem) -> Candidate | None:
    """A candidate at a setting's sites: itself, or some sites of one with a value at every site;
    None where it is at others. A tone's has its frequency."""
    if candidate.effect.tone:
        candidate = tones.at_frequency(candidate, setting.values["frequency_Hz"], problem.model)
    if setting.sites is None:
        return candidate
    sites = tuple(int(site) for site in setting.sites)
    if candidate.sites == sites:
        return candidate
    return sparse(candidate, sites) if candidate.scope == "dense" else None


def _agrees(placed: Setting, setting: Setting, candidate: Candidate) -> bool:
    """Whether a candidate's setting has the values that are stated; what it leaves to a recording
    is no value, nor is one that does nothing, of a parameter that other skins have."""
    effect, polar = candidate.effect, candidate.effect.polar
    of_recording = effect.recorded_values(0.0)
    for key, value in placed.values.items():
        stated = setting.values[key]
        if value is None or stated is None:
            if value is stated or key in of_recording:
                continue
            if value is None and np.all(stated == effect.parameters[key].neutral):
                continue
            return False
        deviation = np.asarray(value, float) - np.asarray(stated, float)
        if polar and key == polar[1]:
            turn = 360.0 / polar[2]
            deviation = (deviation + 0.5 * turn) % turn - 0.5 * turn
        scale = candidate.scales.typical_change(effect.parameters[key])
        if np.any(np.abs(deviation) > TOLERANCE * max(scale, np.abs(stated).max(initial=0.0))):
            return False
    return True
