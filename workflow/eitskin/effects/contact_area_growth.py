"""A probe that sinks in: its contact widens with the force."""

import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect


class ContactAreaGrowth(TouchEffect):
    """radius (F / 1 N)^exponent; 1/3 for a sphere on a half-space."""

    name = "contact-area-growth"
    driver = "force"
    parameters = {"exponent": Parameter("1", 0.0, -0.2, 1.0, scale=0.15, dense=False)}
    source = "Hertz 1882; Johnson 1985"
    mend = "press with a flat-ended probe"
    finding = (
        "The contact widens with the force: its radius goes as the force to the power of"
        " {exponent}."
    )
    shown_by = "presses from light to hard, with three probes of different size"
    confusable = ("contact-law", "probe-radius")

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches with their radius grown; those without a force keep it."""
        grown = touches["force_N"].where(touches["force_N"] > 0, 1.0) ** setting.values["exponent"]
        return touches.assign(radius_mm=touches["radius_mm"] * grown)
