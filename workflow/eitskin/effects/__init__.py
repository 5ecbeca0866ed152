"""The catalogue of effects: one file of this package each, found by being there."""

import importlib
import pkgutil
import re
from collections.abc import Iterable, Iterator

from eitskin.effects.effect import DRIVERS, ORDER, SITES, STAGES, Effect, InstrumentEffect
from eitskin.errors import InputError

EFFECTS: dict[str, Effect] = {}
# What every effect says of itself; `stage` comes from the class that it is of.
SAID = "driver", "parameters", "source", "mend", "finding", "shown_by"


def discover() -> None:
    """Put the effects of every file in this package's `__path__` into EFFECTS, by name.

    Called on import, and by whoever adds a folder to the path. Raises InputError for a name that
    two effects have, and for an effect that leaves out what every one has to say or says what
    none can.
    """
    for found in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{found.name}")
        for kind in vars(module).values():
            own = isinstance(kind, type) and kind.__module__ == module.__name__
            if own and issubclass(kind, Effect) and hasattr(kind, "name"):
                missing = [one for one in SAID if not hasattr(kind, one)]
                if missing:
                    without = f"no {' and no '.join(missing)}"
                    raise InputError(module.__name__, kind.name, without, ", ".join(SAID))
                for place, wrong, expected in _wrong(kind):
                    raise InputError(module.__name__, f"{kind.name}: {place}", wrong, expected)
                known = EFFECTS.setdefault(kind.name, kind())
                if type(known) is not kind:
                    there = f"that of {type(known).__module__} too"
                    raise InputError(module.__name__, kind.name, there, "a name of its own")


def _wrong(kind: type[Effect]) -> Iterator[tuple[str, str, str]]:
    """What an effect says that no effect can: the attribute, what it is, what is expected."""
    if getattr(kind, "stage", None) not in STAGES:
        yield "stage", repr(getattr(kind, "stage", None)), "a class of a stage, as WiringEffect"
        return
    if kind.driver not in DRIVERS:
        yield "driver", repr(kind.driver), f"one of {', '.join(DRIVERS)}"
    orders = ORDER.get(kind.stage, (None,))
    if kind.order not in orders:
        yield "order", repr(kind.order), f"one of {', '.join(map(str, orders))}"
    if not isinstance(kind.sites, tuple) or not set(kind.sites) <= set(SITES):
        yield "sites", repr(kind.sites), f"a tuple of {', '.join(SITES)}"
    for key, parameter in kind.parameters.items():
        if parameter.low >= parameter.high:
            found = f"low {parameter.low:g}, high {parameter.high:g}"
            yield f"parameters: {key}", found, "low below high"
    if not isinstance(kind.apart, tuple) or not set(kind.apart) <= set(kind.parameters):
        yield "apart", repr(kind.apart), f"a tuple of {', '.join(kind.parameters)}"
    for method in ("amounts", "finding_together") if kind.apart else ():
        if getattr(kind, method) is getattr(Effect, method):
            yield "apart", f"no {method}", "what they come to, and a sentence of it"
    known = ["site", *kind.parameters, *(f"{key}:%" for key in kind.parameters)]
    for gap in re.findall(r"\{([^{}|]*)\}", kind.finding):
        if gap not in known:
            yield "finding", f"{{{gap}}}", f"one of {', '.join(known)}"


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
