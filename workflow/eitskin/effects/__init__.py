"""The catalogue of effects: one file of this package each, found by being there."""

import importlib
import pkgutil

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
