"""A touch that changes the conductivity more, or less, than believed."""

import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect


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

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches with their contrast multiplied."""
        return touches.assign(contrast_per_N=touches["contrast_per_N"] * setting.values["ratio"])
