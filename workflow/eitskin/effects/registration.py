"""A robot whose origin or direction is not the skin's."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect


class Registration(TouchEffect):
    """True place = R(rotation) reported + (dx, dy), counter-clockwise about the skin's centre."""

    name = "registration"
    driver = "position"
    parameters = {
        "dx_mm": Parameter("mm", 0.0, -50.0, 50.0, scale=1.0, dense=False),
        "dy_mm": Parameter("mm", 0.0, -50.0, 50.0, scale=1.0, dense=False),
        "rotation_deg": Parameter("°", 0.0, -180.0, 180.0, scale=1.0, dense=False),
    }
    source = "Touch with Insight, § II-B"
    mend = "touch three marks on the skin and fit the robot's frame to them"
    finding = (
        "Touches are not where they are reported: they are turned by {rotation_deg} and shifted"
        " by {dx_mm} along x and {dy_mm} along y."
    )
    shown_by = "touches at known places all over the skin"
    confusable = ("electrode-position",)

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches at their true places."""
        angle = np.radians(setting.values["rotation_deg"])
        c, s = np.cos(angle), np.sin(angle)
        x, y = touches["x_mm"], touches["y_mm"]
        return touches.assign(
            x_mm=c * x - s * y + setting.values["dx_mm"],
            y_mm=s * x + c * y + setting.values["dy_mm"],
        )
