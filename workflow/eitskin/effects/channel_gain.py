"""Gains of single channels."""

import numpy as np

from eitskin.effects.effect import InstrumentEffect, Parameter, Setting


class ChannelGain(InstrumentEffect):
    """v_i -> g_i v_i. Equation 9's gains are its dense form, mirror-tied, g_i = g_(M-1-i)."""

    name = "channel-gain"
    driver = "static"
    sites = "channels"
    parameters = {"gain": Parameter("1", 1.0, 0.0, 10.0)}
    source = "Touch with Insight, equation 9"

    def change(
        self, voltage: np.ndarray, setting: Setting, channels: np.ndarray, force_N: np.ndarray
    ) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        gain = np.ones(voltage.shape[1])
        gain[setting.sites] = setting.values["gain"]
        return voltage * gain
