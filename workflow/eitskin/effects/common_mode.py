"""An amplifier that also reads what its two inputs have in common."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class CommonMode(InstrumentEffect):
    """v + ratio times the mean potential of the measuring pair above the sink."""

    name = "common-mode"
    order = "common mode"
    on_readings = False
    driver = "static"
    parameters = {"ratio": Parameter("1", 0.0, -1.0, 1.0, scale=1e-3, dense=False)}
    source = "Rosell, Riu 1992"
    mend = "drive symmetrically, or use an amplifier that rejects more of the common mode"
    finding = "The amplifier adds to each reading {ratio} times what its two inputs have in common."
    shown_by = "absolute values, with drive and measurement of every channel exchanged too"
    confusable = ("offset", "ground-return")

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        return voltage + setting.values["ratio"] * frames.above_sink_V
