"""The catalogue of effects: every file of this package that defines an Effect is part of it."""

import inspect
import pkgutil
import re
from collections.abc import Callable, Collection, Iterable, Iterator

import numpy as np

from eitskin.effects.effect import (
    DRIVERS,
    OF_READING,
    ORDER,
    SITES,
    STAGES,
    Combination,
    Effect,
    InstrumentEffect,
    Parameter,
)
from eitskin.errors import InputError, imported
from eitskin.physics.geometry import even_angles
from eitskin.physics.skin import Skin

EFFECTS: dict[str, Effect] = {}
# Attributes that every effect must define; `stage` comes from its base class.
REQUIRED_ATTRIBUTES = "driver", "parameters", "source", "mend", "finding", "shown_by"
# One of these is the method of every stage's base class.
STAGE_METHODS = "change", "admittance", "force_shift"
EXAMPLE_SKIN = Skin(50.0, 3.0, 0.5, tuple(even_angles(8).tolist()), 5.0, 1e-3, 1e-3, 0.5)


def discover() -> None:
    """Put the effects of every file in this package's `__path__` into EFFECTS, by name.

    Called on import, and again after a folder was added to the path. Raises InputError for a file
    that is not Python, for a name that two effects have, and for an effect without a name, without
    a required attribute or with contradictory ones.
    """
    kinds = [kind for module in pkgutil.iter_modules(__path__) for kind in _kinds(module.name)]
    named_kinds = [kind for kind in kinds if hasattr(kind, "name")]
    names = {*EFFECTS, *(kind.name for kind in named_kinds)}
    for kind in kinds:
        if kind not in named_kinds and not kind.__subclasses__():
            raise InputError(kind.__module__, kind.__name__, "no name", "that of the effect")
    for kind in named_kinds:
        missing = [attribute for attribute in REQUIRED_ATTRIBUTES if not hasattr(kind, attribute)]
        if missing:
            actual = f"no {' and no '.join(missing)}"
            raise InputError(kind.__module__, kind.name, actual, ", ".join(REQUIRED_ATTRIBUTES))
        for place, actual, expected in _contradictions(kind, names):
            raise InputError(kind.__module__, f"{kind.name}: {place}", actual, expected)
        effect = EFFECTS.setdefault(kind.name, kind())
        if type(effect) is not kind:
            actual = f"that of {type(effect).__module__} too"
            raise InputError(kind.__module__, kind.name, actual, "a name of its own")


def _kinds(name: str) -> list[type[Effect]]:
    """The effect classes that a module of this package defines, without the base classes of
    stages."""
    module = imported(f"{__name__}.{name}")
    classes = [value for value in vars(module).values() if isinstance(value, type)]
    return [
        kind
        for kind in classes
        if kind.__module__ == module.__name__ != Effect.__module__ and issubclass(kind, Effect)
    ]


def _contradictions(kind: type[Effect], names: Collection[str]) -> Iterator[tuple[str, str, str]]:
    """Attributes of an effect that no effect may have: the attribute, its value, the expected
    one. Only the first counts, as others may follow from it. names: of all effects."""
    base = next(ancestor for ancestor in kind.__mro__ if ancestor.__module__ == Effect.__module__)
    if base is Effect or kind.stage not in STAGES:
        yield "stage", repr(getattr(kind, "stage", None)), "a class of a stage, as WiringEffect"
    if not isinstance(kind.parameters, dict):
        yield "parameters", repr(kind.parameters), "a dict of a Parameter by name"
    for key, parameter in kind.parameters.items():
        for attribute, actual, expected in _parameter_contradictions(parameter):
            yield f"parameters: {key}{attribute}", actual, expected
    if kind.driver not in DRIVERS:
        yield "driver", repr(kind.driver), f"one of {', '.join(DRIVERS)}"
    orders = ORDER.get(kind.stage, (None,))
    if kind.order not in orders:
        yield "order", repr(kind.order), f"one of {', '.join(map(str, orders))}"
    if not isinstance(kind.sites, tuple) or not set(kind.sites) <= set(SITES):
        yield "sites", repr(kind.sites), f"a tuple of {', '.join(SITES)}"
    yield from _method_contradictions(kind, base)
    combination = kind.combination
    if combination is not None and not isinstance(combination, Combination):
        yield "combination", repr(combination), "a Combination"
    elif combination is not None and not set(combination.parameters) <= set(kind.parameters):
        expected = f"some of {', '.join(kind.parameters)}"
        yield "combination", ", ".join(combination.parameters), expected
    placeholders = ["site", *kind.parameters, *(f"{key}:%" for key in kind.parameters)]
    wholes = [key for key, parameter in kind.parameters.items() if parameter.whole]
    placeholders += [f"{key}:{whole}" for key in kind.parameters for whole in wholes]
    for placeholder in re.findall(r"\{([^{}|]*)\}", kind.finding):
        if placeholder not in placeholders:
            yield "finding", f"{{{placeholder}}}", f"one of {', '.join(placeholders)}"
    equivalents = (name for identity in kind.identities for name in identity.names)
    for attribute, related in (("confusable", kind.confusable), ("identities", equivalents)):
        for name in related:
            if name not in names:
                yield attribute, repr(name), "names of effects"
    effect = kind()
    for start in effect.starts(EXAMPLE_SKIN, np.ones((1, 1))):
        for key, parameter in kind.parameters.items():
            has_start = key in start or effect.neutral(key, EXAMPLE_SKIN) is not None
            if not (has_start or parameter.optional or (kind.tone and key == "frequency_Hz")):
                expected = "one that does nothing, optional=True, or a value in each of `starts`"
                yield f"parameters: {key}", "neutral None", expected


def _parameter_contradictions(parameter: Parameter) -> Iterator[tuple[str, str, str]]:
    """The same of one parameter; the attribute is the suffix to the parameter's name."""
    if not isinstance(parameter, Parameter):
        yield "", repr(parameter), "a Parameter"
    if not isinstance(parameter.unit, str) or not parameter.unit:
        yield ", unit", repr(parameter.unit), 'a unit, "1" of a ratio'
    low, high, neutral = parameter.low, parameter.high, parameter.neutral
    if low >= high:
        yield "", f"low {low:g}, high {high:g}", "low below high"
    if neutral is not None and not low <= neutral <= high:
        yield ", neutral", f"{neutral:g}", f"one of {low:g} to {high:g}, or None"
    if not parameter.scale > 0:
        yield ", scale", f"{parameter.scale:g}", "more than 0"
    if parameter.of_reading and parameter.unit not in OF_READING:
        expected = f"one of {', '.join(OF_READING)}, as it is of_reading"
        yield ", unit", repr(parameter.unit), expected


def _method_contradictions(
    kind: type[Effect], base: type[Effect]
) -> Iterator[tuple[str, str, str]]:
    """The same of the methods that the base class of a stage requires."""
    required = [*STAGE_METHODS, "slope"] if "channels" in kind.sites else STAGE_METHODS
    methods = {**vars(Effect), **vars(base)}
    for name, method in methods.items():
        override = getattr(kind, name)
        if inspect.isfunction(method) and override is method and name in required:
            yield name, "nothing", f"{name}({_parameter_list(method)})"
        elif inspect.isfunction(method) and override is not method:
            try:
                inspect.signature(override).bind(*inspect.signature(method).parameters)
            except TypeError:
                signature = f"{name}({_parameter_list(override)})" if callable(override) else None
                yield name, signature or repr(override), f"{name}({_parameter_list(method)})"


def _parameter_list(method: Callable) -> str:
    return ", ".join(inspect.signature(method).parameters)


discover()


def catalogue_names() -> list[str]:
    """Names that a diagnosis may report: all effects except composite ones."""
    return [name for name, effect in EFFECTS.items() if not effect.composite]


def modules(names: Iterable[str]) -> list[str]:
    """The modules that define these effects, sorted and unique. Raises KeyError for an unknown
    name."""
    return sorted({type(EFFECTS[name]).__module__ for name in names})


def on_readings(name: str) -> bool:
    """Whether the effect acts on readings alone; otherwise it needs the forward solve.

    Raises KeyError for an unknown name.
    """
    effect = EFFECTS[name]
    return isinstance(effect, InstrumentEffect) and effect.on_readings
