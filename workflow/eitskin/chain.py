"""A simulated configuration as a chain: the skin's effects, then the instrument's one by one."""

from eitskin.effects import stage_of


def skin_effects(effects: list[dict]) -> list[dict]:
    """The effects that need a forward solve, in the order of the configuration."""
    return [effect for effect in effects if stage_of(effect["name"]) != "instrument"]


def instrument_effects(effects: list[dict]) -> list[dict]:
    """The effects that act on voltages alone, in the order of the configuration."""
    return [effect for effect in effects if stage_of(effect["name"]) == "instrument"]


def links(effects: list[dict]) -> list[str]:
    """Names of the chain's stages: `0-skin`, then `<k>-<effect>` for the k-th instrument effect."""
    names = [effect["name"] for effect in instrument_effects(effects)]
    return ["0-skin", *(f"{k}-{name}" for k, name in enumerate(names, start=1))]
