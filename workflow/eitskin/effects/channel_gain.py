"""Gains of single channels."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class ChannelGain(InstrumentEffect):
    """v_i -> g_i v_i. Equation 9's gains are its dense form, mirror-tied, g_i = g_(M-1-i)."""

    name = "channel-gain"
    driver = "static"
    order = "gain"
    sites = ("channels",)
    parameters = {"gain": Parameter("1", 1.0, 0.0, 10.0, scale=0.05)}
    source = "Touch with Insight, equation 9"
    mend = "calibrate channel {site} with a resistor phantom"
    confusable = ("drive-gain", "measurement-gain")

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage * setting.at_channels("gain", frames.channels)
