"""Measuring pairs whose amplifier is not what the board believes."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class MeasurementGain(InstrumentEffect):
    """All channels of one measuring pair, times a gain; a pair is named by its plus electrode."""

    name = "measurement-gain"
    order = "gain"
    driver = "static"
    sites = ("measures",)
    parameters = {"gain": Parameter("1", 1.0, 0.0, 10.0, scale=0.05)}
    source = "Hahn, Just, Dittmar, Hellige 2008"
    mend = "calibrate the amplifier with electrode {site} at its plus"
    confusable = ("channel-gain",)

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage * setting.at_channels("gain", frames.channels)
