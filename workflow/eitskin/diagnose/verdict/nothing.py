"""Whether what is stated of an effect's size leaves room for no effect at all."""

import numpy as np

from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect


def holds_nothing(entry: dict) -> bool:
    """Whether every size of an effect of diagnosis.json may be that of no effect, by its stated
    90 % interval.

    Amounts in the place of parameters are above 0. Of values at several sites those of a sparse
    effect must each be something, as each is stated; those of a dense one not all be nothing.
    """
    effect = EFFECTS[entry["name"]]
    if "amounts" in entry and effect.combination is not None:
        return False
    estimates = entry["parameters"]
    sizes = [key for key in estimates if measures_size(effect, key)]
    judge = np.any if entry["scope"] == "sparse" else np.all
    return bool(sizes) and all(judge(may_be_none(effect, key, estimates[key])) for key in sizes)


def measures_size(effect: Effect, key: str) -> bool:
    """Whether a parameter has a value that turns the effect into nothing; the angle of a size with
    a direction has none."""
    is_angle = effect.polar is not None and key == effect.polar[1]
    return effect.parameters[key].neutral is not None and not is_angle


def may_be_none(effect: Effect, key: str, estimate: dict) -> np.ndarray:
    """Of each value of an estimate of diagnosis.json, whether its interval holds that of no
    effect; shape () or (sites,)."""
    neutral = effect.parameters[key].neutral
    assert neutral is not None
    return (np.array(estimate["low"]) <= neutral) & (np.array(estimate["high"]) >= neutral)
