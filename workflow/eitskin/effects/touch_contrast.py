"""A touch that changes the conductivity more, or less, than believed."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide
from eitskin.quantities import number


def faulty_load_cell(law: NamedEffect, force_N: np.ndarray, wording: str) -> OtherSide:
    """Of a law of the force: a load cell that reads another force than there is; force_N (N,): the
    true one; wording: of what it is."""
    sentence = (
        f"Instead the load cell may be at fault, the true force being {wording}. Put known weights"
        " on it."
    )
    return OtherSide(law.gap(law.simulated(force_N=force_N)), sentence)


def scaled_load_cell(contrast: NamedEffect) -> OtherSide:
    """A load cell whose reading is a multiple of the force."""
    ratio = float(contrast.values["ratio"])
    return faulty_load_cell(
        contrast, ratio * contrast.force_N, f"{number(ratio)} times its reading"
    )


class TouchContrast(TouchEffect):
    """contrast_per_N * ratio."""

    name = "touch-contrast"
    driver = "force"
    parameters = {"ratio": Parameter("1", 1.0, 0.0, 100.0, scale=0.3, dense=False)}
    source = "Touch with Insight, § II-D"
    mend = "press once more with a known force"
    finding = "A touch changes the conductivity {ratio} times as much as the simulation assumes."
    shown_by = "presses of known force"
    confusable = ("probe-radius", "contact-law", "force-offset", "indenter-grounding")
    identities = (Identity((), scaled_load_cell),)

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches with their contrast multiplied."""
        return touches.assign(contrast_per_N=touches["contrast_per_N"] * setting.values["ratio"])
