"""The catalogue of effects: one file of this package each, found by being there."""

import importlib
import pkgutil
from collections.abc import Iterable

from eitskin.effects.effect import Effect, InstrumentEffect

EFFECTS: dict[str, Effect] = {}
for _module in pkgutil.iter_modules(__path__):
    for _object in vars(importlib.import_module(f"{__name__}.{_module.name}")).values():
        if isinstance(_object, type) and issubclass(_object, Effect) and hasattr(_object, "name"):
            EFFECTS[_object.name] = _object()


def on_readings(name: str) -> bool:
    """Whether the effect acts on readings alone; else it needs the forward solve.

    Raises KeyError for an unknown name.
    """
    effect = EFFECTS[name]
    return isinstance(effect, InstrumentEffect) and effect.on_readings


def catalogue_names() -> list[str]:
    """The effects that a diagnosis may name: all but combinations of others."""
    return [name for name, effect in EFFECTS.items() if not effect.composite]


def modules(names: Iterable[str]) -> list[str]:
    """The modules that define effects, each once, in order. Raises KeyError for an unknown name."""
    return sorted({type(EFFECTS[name]).__module__ for name in names})
