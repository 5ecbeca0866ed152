"""Candidates: effects of the catalogue at definite sites, with coordinates to be fitted.

A coordinate is 0 where the effect does nothing, or at its start, and 1 at a typical change of the
parameter: of its logarithm where it stays above 0. Two parameters that are a size and an angle have
Cartesian coordinates.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from eitskin.effects.effect import ORDER, VOLTS, Effect, Parameter, Setting, site_of
from eitskin.physics.skin import Skin

BOUND_MARGIN = 1e-3  # of a typical change: a parameter this close to a bound is at it


@dataclass(frozen=True)
class Scales:
    """Sizes of a recording that scale typical changes: median |v| and current; multiple: of the
    usual typical change, where it is another."""

    reading_V: float
    current_A: float
    multiple: float = 1.0

    def typical_change(self, parameter: Parameter) -> float:
        """A typical change of a parameter, in its unit; of its logarithm where low > 0."""
        scale = self.multiple * parameter.scale
        if not parameter.of_reading:
            return scale
        if parameter.unit in VOLTS:
            return scale * self.reading_V ** VOLTS[parameter.unit]
        return scale * self.current_A / self.reading_V


@dataclass(frozen=True)
class Candidate:
    """One effect at definite sites, its coordinates to be fitted.

    scope: sparse (a few sites, each with its value), dense (all sites, each with its value), common
    (all sites with one value). start: values of parameters without a neutral value, and of those
    that are held. looks: how many candidates of the effect are tried. names: parameter and position
    among the sites (None: all) of every coordinate.
    """

    effect: Effect
    kind: str | None
    sites: tuple[int, ...] | None
    scope: str
    start: dict[str, float]
    skin: Skin
    scales: Scales
    looks: int = 1
    names: list[tuple[str, int | None]] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", list(self._coordinates()))

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def site_indices(self) -> tuple[int, ...]:
        """The sites of a candidate that has some."""
        assert self.sites is not None
        return self.sites

    @property
    def size(self) -> int:
        """The number of coordinates."""
        return len(self.names)

    @property
    def linear(self) -> np.ndarray:
        """(size,) bool: whether a coordinate changes readings at the neutral values; the others
        shape what these change."""
        return np.array([key not in self.start for key, _ in self.names], dtype=bool)

    @property
    def key(self) -> tuple:
        """What identifies the candidate."""
        return self.name, self.kind, self.sites, self.scope, tuple(sorted(self.start.items()))

    def _coordinates(self) -> Iterator[tuple[str, int | None]]:
        for key, parameter in self.effect.parameters.items():
            if parameter.whole or (self.effect.polar and key == self.effect.polar[1]):
                continue
            neutral = self.effect.neutral_at(key, self.skin, self.sites)
            if key in self.start:
                if self.start[key] != neutral:
                    yield key, None
            elif neutral is not None:
                if self.effect.polar and key == self.effect.polar[0]:
                    yield key, 0
                    yield key, 1
                elif self.scope in ("sparse", "dense") and parameter.dense:
                    for site_position in range(len(self.site_indices)):
                        yield key, site_position
                else:
                    yield key, None

    def setting(self, coordinates: np.ndarray) -> Setting:
        """The effect at coordinates (size,), clipped to the bounds of its parameters."""
        values: dict = {}
        sites = None if self.sites is None else np.array(self.sites)
        for key, parameter in self.effect.parameters.items():
            neutral = self.start.get(key, self.effect.neutral_at(key, self.skin, self.sites))
            positions = [i for i, (name, _) in enumerate(self.names) if name == key]
            scale = self.scales.typical_change(parameter)
            change = scale * np.asarray(coordinates)[positions]
            if not positions:
                if key not in values:
                    values[key] = neutral
                continue
            assert neutral is not None
            if self.effect.polar and key == self.effect.polar[0]:
                size, angle = np.hypot(*change), np.arctan2(change[1], change[0])
                value = neutral * np.exp(size) if parameter.low > 0 else neutral + size
                values[key] = float(np.clip(value, parameter.low, parameter.high))
                _, angle_key, multiple = self.effect.polar
                values[angle_key] = float(np.degrees(angle) / multiple)
            else:
                if _logarithmic(parameter):
                    span = np.log(parameter.high / parameter.low)
                    value = neutral * np.exp(np.clip(change, -span, span))
                else:
                    value = neutral + change
                value = np.clip(value, parameter.low, parameter.high)
                per_site = self.scope in ("sparse", "dense") and parameter.dense
                values[key] = value if per_site and sites is not None else float(value[0])
        return Setting(self.effect, sites, values, self.kind)

    def coordinates(self, values: dict) -> np.ndarray:
        """(size,): coordinates at which `setting` has these values, or the nearest."""
        coordinates = np.zeros(self.size)
        for key in dict.fromkeys(name for name, _ in self.names):
            positions = [i for i, (name, _) in enumerate(self.names) if name == key]
            parameter = self.effect.parameters[key]
            neutral = self.start.get(key, self.effect.neutral_at(key, self.skin, self.sites))
            assert neutral is not None
            value = np.asarray(neutral if values[key] is None else values[key], float)
            if np.size(value) > len(positions):
                value = np.mean(value)
            change = np.log(value / neutral) if _logarithmic(parameter) else value - neutral
            if self.effect.polar and key == self.effect.polar[0]:
                _, angle_key, multiple = self.effect.polar
                angle = multiple * np.radians(values[angle_key])
                change = change * np.array([np.cos(angle), np.sin(angle)])
            coordinates[positions] = change / self.scales.typical_change(parameter)
        return coordinates

    def at_bound(self, key: str, value: np.ndarray) -> np.ndarray:
        """The bound, low or high, that each of a parameter's values is at; None: at neither, or not
        fitted. A size of 0, which has no direction, is at none."""
        bounds = np.full(np.shape(value), None)
        if all(name != key for name, _ in self.names):
            return bounds
        parameter = self.effect.parameters[key]
        scaled = np.log if _logarithmic(parameter) else np.asarray
        is_polar_size = self.effect.polar is not None and key == self.effect.polar[0]
        for bound in ("high",) if is_polar_size else ("low", "high"):
            distance = np.abs(scaled(value) - scaled(getattr(parameter, bound)))
            bounds[distance <= BOUND_MARGIN * self.scales.typical_change(parameter)] = bound
        return bounds

    def item(self, coordinates: np.ndarray) -> dict:
        """The effect at coordinates (size,) as an entry of the configuration."""
        setting = self.setting(coordinates)
        item: dict = {"name": self.name}
        if self.kind is not None and self.scope != "common":
            item[self.kind] = [int(site) for site in self.site_indices]
        values = {
            key: np.asarray(value).tolist()
            for key, value in setting.values.items()
            if value is not None
        }
        if values:
            item["parameters"] = values
        return item


def exclusive_channels(
    candidate: Candidate, other_effects: list[Effect], channels: np.ndarray
) -> np.ndarray | None:
    """(size, M) bool: the channels that each coordinate changes and no other does; None where
    coordinates share channels, or another effect spreads their changes to others."""
    on_readings = candidate.effect.stage == "instrument" and candidate.kind != "electrodes"
    if candidate.kind is None or candidate.scope == "common" or not on_readings:
        return None
    order = ORDER["instrument"]
    before_mixing = order.index(candidate.effect.order) < order.index("mixing")
    if before_mixing and any(effect.order == "mixing" for effect in other_effects):
        return None
    return site_of(candidate.kind, channels) == np.array(candidate.sites)[:, None]


def _logarithmic(parameter: Parameter) -> bool:
    return parameter.low > 0


def log_subset_count(count: int, size: int) -> float:
    """Logarithm of the number of subsets of `size` among `count` sites."""
    return float(np.log([(count - i) / (i + 1) for i in range(size)]).sum())


def without_site(candidate: Candidate, position: int) -> Candidate:
    """A sparse candidate without the site at a position."""
    sites = tuple(s for i, s in enumerate(candidate.site_indices) if i != position)
    looks = max(1, round(candidate.looks ** (len(sites) / len(candidate.site_indices))))
    return replace(candidate, sites=sites, looks=looks)


def is_discrete(candidate: Candidate) -> bool:
    """Whether a candidate is present or absent: no coordinate takes it continuously from none."""
    return not candidate.linear.any() and not candidate.effect.tone


def is_wiring_fault(candidate: Candidate) -> bool:
    """Whether a candidate is a discrete fault of the wiring."""
    in_wiring = candidate.effect.stage == "wiring" and not candidate.effect.last_resort
    return in_wiring and is_discrete(candidate)


def is_by_channel(candidate: Candidate) -> bool:
    """Whether the sites of a candidate are single channels."""
    return candidate.kind == "channels"


def is_linearised(candidate: Candidate) -> bool:
    """Whether a candidate is scored by its derivatives alone."""
    return not (is_by_channel(candidate) or is_discrete(candidate) or candidate.effect.tone)


def replaces_instrument(effects: list[Candidate]) -> bool:
    """Whether some of these effects put another instrument in place of the owner's."""
    return any(candidate.effect.last_resort for candidate in effects)
