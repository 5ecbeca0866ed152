"""A simulated configuration as a chain: the skin's effects, then the instrument's one by one.

The links are named `0-skin` and `<k>-<effect>` for the k-th effect that acts on readings alone.
"""

from eitskin.effects import EFFECTS, on_readings
from eitskin.effects.effect import ORDER

SKIN = "0-skin"


def skin_effects(effects: list[dict]) -> list[dict]:
    """The effects that need a forward solve, in the order of the configuration."""
    return [effect for effect in effects if not on_readings(effect["name"])]


def instrument_effects(effects: list[dict]) -> dict[str, dict]:
    """The effects that act on readings alone, by link, in the order of the instrument."""
    on_readings_alone = [effect for effect in effects if on_readings(effect["name"])]
    on_readings_alone.sort(
        key=lambda effect: ORDER["instrument"].index(EFFECTS[effect["name"]].order)
    )
    return {f"{k}-{effect['name']}": effect for k, effect in enumerate(on_readings_alone, start=1)}


def last_link(effects: list[dict]) -> str:
    """The link whose voltages carry every effect."""
    return [SKIN, *instrument_effects(effects)][-1]


def link_before(effects: list[dict], link: str) -> str:
    """The link that `link` is applied to; ValueError for a link that is not in the chain."""
    links = [SKIN, *instrument_effects(effects)]
    return links[links.index(link, 1) - 1]
