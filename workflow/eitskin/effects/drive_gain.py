"""Drives whose current is not what the board believes."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class DriveGain(InstrumentEffect):
    """All channels of one drive, times a gain; a drive is named by its source electrode."""

    name = "drive-gain"
    order = "gain"
    driver = "static"
    sites = ("drives",)
    parameters = {"gain": Parameter("1", 1.0, 0.0, 10.0, scale=0.05)}
    source = "Hahn, Just, Dittmar, Hellige 2008"
    mend = "check the current with electrode {site} as source"
    confusable = ("channel-gain",)

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage * setting.at_channels("gain", frames.channels)
