"""What may have been left out: every effect of the catalogue at every site it may have.

A candidate has coordinates that are 0 where it does nothing (or where its start has it) and 1 at
a change of typical size: additive, logarithmic where a parameter stays above 0, Cartesian where
two parameters are a size and an angle.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from eitskin.effects.effect import ORDER, VOLTS, Effect, Parameter, Setting, site_of
from eitskin.physics.skin import Skin

SLIVER = 1e-3  # of a typical change: so near a bound, a parameter has ended at it


@dataclass(frozen=True)
class Scales:
    """Sizes that turn an effect's own scale into the recording's: median |v| and current; times:
    how many of these are a typical change."""

    reading_V: float
    current_A: float
    times: float = 1.0

    def of(self, parameter: Parameter) -> float:
        """A typical change of the parameter, in its unit; of its logarithm where low > 0."""
        scale = self.times * parameter.scale
        if not parameter.of_reading:
            return scale
        if parameter.unit in VOLTS:
            return scale * self.reading_V ** VOLTS[parameter.unit]
        return scale * self.current_A / self.reading_V


@dataclass(frozen=True)
class Candidate:
    """One effect at definite sites, its coordinates to be fitted.

    scope: sparse (the sites, each with its value), dense (all sites, each its own), common (all
    sites, one value). start: values of parameters without a neutral one, and of those held.
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
    def own_sites(self) -> tuple[int, ...]:
        """`sites` of a candidate that has some."""
        assert self.sites is not None
        return self.sites

    @property
    def size(self) -> int:
        """How many coordinates there are."""
        return len(self.names)

    @property
    def linear(self) -> np.ndarray:
        """(size,): whether the coordinate changes readings at the neutral values; the others say
        how, once it does."""
        return np.array([key not in self.start for key, _ in self.names], dtype=bool)

    @property
    def key(self) -> tuple:
        """What tells it from other candidates."""
        return self.name, self.kind, self.sites, self.scope, tuple(sorted(self.start.items()))

    def _coordinates(self) -> Iterator[tuple[str, int | None]]:
        for key, parameter in self.effect.parameters.items():
            if parameter.whole or (self.effect.polar and key == self.effect.polar[1]):
                continue
            neutral = self.effect.neutral(key, self.skin)
            if key in self.start:
                if self.start[key] != neutral:
                    yield key, None
            elif neutral is not None:
                if self.effect.polar and key == self.effect.polar[0]:
                    yield key, 0
                    yield key, 1
                elif self.scope in ("sparse", "dense") and parameter.dense:
                    for place in range(len(self.own_sites)):
                        yield key, place
                else:
                    yield key, None

    def setting(self, coordinates: np.ndarray) -> Setting:
        """The effect at coordinates (size,), kept within its parameters' bounds."""
        values: dict = {}
        sites = None if self.sites is None else np.array(self.sites)
        for key, parameter in self.effect.parameters.items():
            neutral = self.start.get(key, self.effect.neutral(key, self.skin))
            at = [i for i, (name, _) in enumerate(self.names) if name == key]
            scale = self.scales.of(parameter)
            moved = scale * np.asarray(coordinates)[at]
            if not at:
                if key not in values:
                    values[key] = neutral
                continue
            assert neutral is not None
            if self.effect.polar and key == self.effect.polar[0]:
                size, angle = np.hypot(*moved), np.arctan2(moved[1], moved[0])
                value = neutral * np.exp(size) if parameter.low > 0 else neutral + size
                values[key] = float(np.clip(value, parameter.low, parameter.high))
                _, other, multiple = self.effect.polar
                values[other] = float(np.degrees(angle) / multiple)
            else:
                value = neutral * np.exp(moved) if _logarithmic(parameter) else neutral + moved
                value = np.clip(value, parameter.low, parameter.high)
                per_site = self.scope in ("sparse", "dense") and parameter.dense
                values[key] = value if per_site and sites is not None else float(value[0])
        return Setting(self.effect, sites, values, self.kind)

    def coordinates(self, values: dict) -> np.ndarray:
        """(size,): those at which `setting` has these values, as near as it can."""
        found = np.zeros(self.size)
        for key in dict.fromkeys(name for name, _ in self.names):
            at = [i for i, (name, _) in enumerate(self.names) if name == key]
            parameter = self.effect.parameters[key]
            neutral = self.start.get(key, self.effect.neutral(key, self.skin))
            assert neutral is not None
            value = np.asarray(neutral if values[key] is None else values[key], float)
            if np.size(value) > len(at):
                value = np.mean(value)
            moved = np.log(value / neutral) if _logarithmic(parameter) else value - neutral
            if self.effect.polar and key == self.effect.polar[0]:
                _, other, multiple = self.effect.polar
                angle = multiple * np.radians(values[other])
                moved = moved * np.array([np.cos(angle), np.sin(angle)])
            found[at] = moved / self.scales.of(parameter)
        return found

    def at_bound(self, key: str, value: np.ndarray) -> np.ndarray:
        """Which bound each of a parameter's values is at, `low` or `high`; None: at neither, or not
        fitted. A size of 0, which has no direction, is at none."""
        ended = np.full(np.shape(value), None)
        if all(name != key for name, _ in self.names):
            return ended
        parameter = self.effect.parameters[key]
        scaled = np.log if _logarithmic(parameter) else np.asarray
        size = self.effect.polar is not None and key == self.effect.polar[0]
        for bound in ("high",) if size else ("low", "high"):
            short = np.abs(scaled(value) - scaled(getattr(parameter, bound)))
            ended[short <= SLIVER * self.scales.of(parameter)] = bound
        return ended

    def item(self, coordinates: np.ndarray) -> dict:
        """The effect as the configuration writes it."""
        setting = self.setting(coordinates)
        item: dict = {"name": self.name}
        if self.kind is not None and self.scope != "common":
            item[self.kind] = [int(site) for site in self.own_sites]
        values = {
            key: np.asarray(value).tolist()
            for key, value in setting.values.items()
            if value is not None
        }
        if values:
            item["parameters"] = values
        return item


def own_channels(
    candidate: Candidate, others: list[Effect], channels: np.ndarray
) -> np.ndarray | None:
    """(size, M): the channels that each coordinate alone moves; None where coordinates share some,
    or where another effect takes them on to others."""
    on_readings = candidate.effect.stage == "instrument" and candidate.kind != "electrodes"
    if candidate.kind is None or candidate.scope == "common" or not on_readings:
        return None
    order = ORDER["instrument"]
    mixed = order.index(candidate.effect.order) < order.index("mixing")
    if mixed and any(effect.order == "mixing" for effect in others):
        return None
    return site_of(candidate.kind, channels) == np.array(candidate.sites)[:, None]


def _logarithmic(parameter: Parameter) -> bool:
    return parameter.low > 0


def log_ways(count: int, size: int) -> float:
    """Logarithm of the number of subsets of `size` among `count` sites."""
    return float(np.log([(count - i) / (i + 1) for i in range(size)]).sum())


def without_site(candidate: Candidate, place: int) -> Candidate:
    """A sparse candidate less one of its sites."""
    sites = tuple(s for i, s in enumerate(candidate.own_sites) if i != place)
    looks = max(1, round(candidate.looks ** (len(sites) / len(candidate.own_sites))))
    return replace(candidate, sites=sites, looks=looks)


def discrete(candidate: Candidate) -> bool:
    """Whether a candidate is there or not: it has no coordinate about which it starts."""
    return not candidate.linear.any() and not candidate.effect.tone


def gross(candidate: Candidate) -> bool:
    """Whether a candidate is a fault of the wiring that is there or not, far from any tangent."""
    of_wiring = candidate.effect.stage == "wiring" and not candidate.effect.last_resort
    return of_wiring and discrete(candidate)


def of_channels(candidate: Candidate) -> bool:
    """Whether a candidate has values of channels."""
    return candidate.kind == "channels"


def of_tangents(candidate: Candidate) -> bool:
    """Whether a candidate is scored by its tangents, and by nothing else."""
    return not (of_channels(candidate) or discrete(candidate) or candidate.effect.tone)


def replaces_instrument(effects: list[Candidate]) -> bool:
    """Whether the instrument is another than its owner's by some of these effects."""
    return any(candidate.effect.last_resort for candidate in effects)
