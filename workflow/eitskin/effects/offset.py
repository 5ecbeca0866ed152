"""Amplifiers that do not read 0 at 0."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class Offset(InstrumentEffect):
    """Added to all channels of a measuring pair, named by its plus electrode, or to single
    ones."""

    name = "offset"
    order = "offset"
    driver = "static"
    sites = ("measures", "channels")
    common = False
    parameters = {"volt": Parameter("V", 0.0, -10.0, 10.0, scale=0.02, of_reading=True)}
    source = "Hahn, Just, Dittmar, Hellige 2008"
    mend = "zero the amplifier at {site} with its inputs shorted"
    finding = "{site} {reads|read} {volt} too much."
    opposite = ("much", "little")
    shown_by = "a recording with absolute values, some of them at another current"
    confusable = ("common-mode", "ground-leak")

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage + setting.at_channels("volt", frames.channels)

    def slope(self, voltage: np.ndarray) -> np.ndarray:
        """(N, M): 1, whatever is read."""
        return np.ones(voltage.shape)
