"""eitskin: physics, learning and diagnosis of EIT tactile skins.

From Python: `read`, `simulate`, `jacobian`, `effect_jacobian`, `pixels`, `diagnose`, `compare`,
`Report`, `Simulator` (`eitskin.scripting`, `eitskin.simulators`), `InputError` (`eitskin.errors`).
They are imported on first use.
"""

from importlib import import_module
from types import ModuleType
from typing import Any

SCRIPTING = "eitskin.scripting"
MODULES = {  # of the names that are offered
    "InputError": "eitskin.errors",
    "Report": SCRIPTING,
    "Simulator": "eitskin.simulators",
    "compare": SCRIPTING,
    "effect_jacobian": SCRIPTING,
    "jacobian": SCRIPTING,
    "pixels": SCRIPTING,
    "read": "eitskin.data.reading",
}
PACKAGES = ("diagnose", "simulate")  # which are called as well
__all__ = (*MODULES, *PACKAGES)


def __getattr__(name: str) -> Any:
    """A name that is offered, imported when it is first asked for (PEP 562)."""
    if name in PACKAGES:
        return import_module(f"eitskin.{name}")
    if name in MODULES:
        return getattr(import_module(MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    submodules = [name for name, value in globals().items() if isinstance(value, ModuleType)]
    return sorted({*__all__, *submodules, *filter(lambda name: name.startswith("__"), globals())})
