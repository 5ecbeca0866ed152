"""A touch that changes the conductivity more, or less, than believed."""

import pandas as pd

from eitskin.effects.effect import Parameter, Setting, TouchEffect


class TouchContrast(TouchEffect):
    """contrast_per_N * ratio."""

    name = "touch-contrast"
    driver = "force"
    sites = None
    parameters = {"ratio": Parameter("1", 1.0, 0.0, 100.0, dense=False)}
    source = "Touch with Insight, § II-D"

    def change(self, touches: pd.DataFrame, setting: Setting) -> pd.DataFrame:
        """Touches with their contrast multiplied."""
        return touches.assign(contrast=touches["contrast"] * setting.values["ratio"])
