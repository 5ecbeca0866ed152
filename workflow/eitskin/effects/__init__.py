"""The catalogue of effects: one file of this package each, found by being there."""

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
    Effect,
    InstrumentEffect,
    Parameter,
)
from eitskin.errors import InputError, imported
from eitskin.physics.geometry import even_angles
from eitskin.physics.skin import Skin

EFFECTS: dict[str, Effect] = {}
# What every effect says of itself; `stage` comes from the class that it is of.
SAID = "driver", "parameters", "source", "mend", "finding", "shown_by"
DONE = "change", "admittance", "force_shift"  # methods of a stage; each class has one
EXAMPLE = Skin(50.0, 3.0, 0.5, tuple(even_angles(8).tolist()), 5.0, 1e-3, 1e-3, 0.5)


def discover() -> None:
    """Put the effects of every file in this package's `__path__` into EFFECTS, by name.

    Called on import, and by whoever adds a folder to the path. Raises InputError for a file that is
    no Python, for a name that two effects have, and for an effect that has none, that leaves out
    what every one has to say or that says what none can.
    """
    kinds = [kind for found in pkgutil.iter_modules(__path__) for kind in _kinds(found.name)]
    named = [kind for kind in kinds if hasattr(kind, "name")]
    names = {*EFFECTS, *(kind.name for kind in named)}
    for kind in kinds:
        if kind not in named and not kind.__subclasses__():
            raise InputError(kind.__module__, kind.__name__, "no name", "that of the effect")
    for kind in named:
        missing = [one for one in SAID if not hasattr(kind, one)]
        if missing:
            without = f"no {' and no '.join(missing)}"
            raise InputError(kind.__module__, kind.name, without, ", ".join(SAID))
        for place, wrong, expected in _wrong(kind, names):
            raise InputError(kind.__module__, f"{kind.name}: {place}", wrong, expected)
        known = EFFECTS.setdefault(kind.name, kind())
        if type(known) is not kind:
            there = f"that of {type(known).__module__} too"
            raise InputError(kind.__module__, kind.name, there, "a name of its own")


def _kinds(name: str) -> list[type[Effect]]:
    """The classes of effects that a module of this package defines, without those of the stages."""
    module = imported(f"{__name__}.{name}")
    classes = [one for one in vars(module).values() if isinstance(one, type)]
    own = [one for one in classes if one.__module__ == module.__name__ != Effect.__module__]
    return [one for one in own if issubclass(one, Effect)]


def _wrong(kind: type[Effect], names: Collection[str]) -> Iterator[tuple[str, str, str]]:
    """What an effect says that no effect can: the attribute, what it is, what is expected; the
    first, as others may follow from it. names: of all effects."""
    base = next(one for one in kind.__mro__ if one.__module__ == Effect.__module__)
    if base is Effect or kind.stage not in STAGES:
        yield "stage", repr(getattr(kind, "stage", None)), "a class of a stage, as WiringEffect"
    if not isinstance(kind.parameters, dict):
        yield "parameters", repr(kind.parameters), "a dict of a Parameter by name"
    for key, parameter in kind.parameters.items():
        for what, found, expected in _wrong_parameter(parameter):
            yield f"parameters: {key}{what}", found, expected
    if kind.driver not in DRIVERS:
        yield "driver", repr(kind.driver), f"one of {', '.join(DRIVERS)}"
    orders = ORDER.get(kind.stage, (None,))
    if kind.order not in orders:
        yield "order", repr(kind.order), f"one of {', '.join(map(str, orders))}"
    if not isinstance(kind.sites, tuple) or not set(kind.sites) <= set(SITES):
        yield "sites", repr(kind.sites), f"a tuple of {', '.join(SITES)}"
    yield from _wrong_methods(kind, base)
    if not isinstance(kind.apart, tuple) or not set(kind.apart) <= set(kind.parameters):
        yield "apart", repr(kind.apart), f"a tuple of {', '.join(kind.parameters)}"
    for method in ("amounts", "finding_together") if kind.apart else ():
        if getattr(kind, method) is getattr(Effect, method):
            yield "apart", f"no {method}", "what they come to, and a sentence of it"
    known = ["site", *kind.parameters, *(f"{key}:%" for key in kind.parameters)]
    for gap in re.findall(r"\{([^{}|]*)\}", kind.finding):
        if gap not in known:
            yield "finding", f"{{{gap}}}", f"one of {', '.join(known)}"
    for other in kind.confusable:
        if other not in names:
            yield "confusable", repr(other), "names of effects"
    effect = kind()
    for start in effect.starts(EXAMPLE, np.ones((1, 1))):
        for key, parameter in kind.parameters.items():
            given = key in start or effect.neutral(key, EXAMPLE) is not None
            if not (given or parameter.optional or (kind.tone and key == "frequency_Hz")):
                expected = "one that does nothing, optional=True, or a value in each of `starts`"
                yield f"parameters: {key}", "neutral None", expected


def _wrong_parameter(parameter: Parameter) -> Iterator[tuple[str, str, str]]:
    """As `_wrong`; of the attribute what follows the parameter's name."""
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


def _wrong_methods(kind: type[Effect], base: type[Effect]) -> Iterator[tuple[str, str, str]]:
    """As `_wrong`, of what the class of its stage has an effect do."""
    needed = [*DONE, "slope"] if "channels" in kind.sites else DONE
    methods = {**vars(Effect), **vars(base)}
    for name, method in methods.items():
        own = getattr(kind, name)
        if inspect.isfunction(method) and own is method and name in needed:
            yield name, "nothing", f"{name}({_taken(method)})"
        elif inspect.isfunction(method) and own is not method:
            try:
                inspect.signature(own).bind(*inspect.signature(method).parameters)
            except TypeError:
                found = f"{name}({_taken(own)})" if callable(own) else repr(own)
                yield name, found, f"{name}({_taken(method)})"


def _taken(method: Callable) -> str:
    return ", ".join(inspect.signature(method).parameters)


discover()


def catalogue_names() -> list[str]:
    """Names that a diagnosis may give: of all effects but the composite."""
    return [name for name, effect in EFFECTS.items() if not effect.composite]


def modules(names: Iterable[str]) -> list[str]:
    """The modules that define the effects named, sorted, each once; KeyError for an unknown one."""
    return sorted({type(EFFECTS[name]).__module__ for name in names})


def on_readings(name: str) -> bool:
    """Whether the effect acts on readings alone; else it needs the forward solve.

    Raises KeyError for an unknown name.
    """
    effect = EFFECTS[name]
    return isinstance(effect, InstrumentEffect) and effect.on_readings
