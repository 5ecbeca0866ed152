"""What gains of channels, of drives and of measuring pairs share; it is no effect by itself."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class GainEffect(InstrumentEffect):
    """Channels times the gain of their site, `sites` saying what a site is."""

    order = "gain"
    driver = "static"
    common = False  # that is the conductivity's
    parameters = {"gain": Parameter("1", 1.0, 0.0, 10.0, scale=0.05)}

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage * setting.at_channels("gain", frames.channels)

    def slope(self, voltage: np.ndarray) -> np.ndarray:
        """(N, M): the reading itself."""
        return voltage
