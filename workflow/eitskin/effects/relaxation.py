"""A gel that gives way under a force that is held."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect
from eitskin.physics.skin import Skin


class Relaxation(TouchEffect):
    """contrast_per_N (F - fraction m), tau dm/dt = F - m, m = 0 when the press begins."""

    name = "relaxation"
    order = "memory"
    driver = "time"
    parameters = {
        "fraction": Parameter("1", 0.0, -1.0, 1.0, scale=0.1, dense=False),
        "tau_s": Parameter("s", None, 1e-3, 1e4, scale=3.0, dense=False),
    }
    source = "standard linear solid; Johnson 1985, § 6.5"
    mend = "read every frame equally long after the force is reached"
    finding = (
        "The skin gives way under a force that is held: {fraction:%} of its answer fades[, with a"
        " time constant of {tau_s}]."
    )
    shown_by = "holds of a minute at one force"
    confusable = ("hysteresis", "force-lag")

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """Time constants from that of a gel's skin to that of its bulk."""
        return [{"tau_s": tau} for tau in (0.3, 1.0, 3.0, 10.0, 30.0)]

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches, the force felt less what has relaxed."""
        assert frames.history is not None
        relaxed_N = frames.history.relaxed_N(setting.values["tau_s"])
        return touches.assign(felt_N=touches["felt_N"] - setting.values["fraction"] * relaxed_N)
