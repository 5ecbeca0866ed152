"""A gel that remembers how hard it was pressed."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect


class Hysteresis(TouchEffect):
    """Unloading: contrast (1 + fraction (1 - F / F_peak)).

    Unloading is wherever the force is below its largest so far in the press, F_peak.
    """

    name = "hysteresis"
    driver = "load-direction"
    parameters = {"fraction": Parameter("1", 0.0, -1.0, 1.0, scale=0.1, dense=False)}
    source = "rate-independent loop between loading and unloading; Mayergoyz 1991"
    mend = "read on the loading branch only"
    finding = (
        "The skin remembers how hard it was pressed: as the force goes back, the contrast changes"
        " by up to {fraction:%}."
    )
    shown_by = "an unloading branch in every press"
    confusable = ("relaxation", "force-lag", "frame-skew")

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches with the contrast of the unloading branch."""
        assert frames.history is not None
        force = touches["force_N"].to_numpy()
        peak = np.maximum(frames.history.peak_N(), force)
        below = np.where(peak > 0, 1.0 - force / np.where(peak > 0, peak, 1.0), 0.0)
        return touches.assign(
            contrast_per_N=touches["contrast_per_N"] * (1.0 + setting.values["fraction"] * below)
        )
