"""A contact that is wider, or narrower, than the probe."""

import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect


class ProbeRadius(TouchEffect):
    """radius * ratio."""

    name = "probe-radius"
    driver = "force"
    parameters = {"ratio": Parameter("1", 1.0, 0.1, 5.0, scale=0.1, dense=False)}
    source = "Touch with Insight, § II-D"
    mend = "measure the probe's contact, with ink or with three probes"
    finding = "The contact is {ratio} times as wide as the probe."
    shown_by = "three probes of different size at the same places"
    confusable = ("touch-contrast", "contact-area-growth")

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches with their radius multiplied."""
        return touches.assign(radius_mm=touches["radius_mm"] * setting.values["ratio"])
