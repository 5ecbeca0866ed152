"""Leakage between neighbouring channels."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class Crosstalk(InstrumentEffect):
    """v_k -> (1 - 2 epsilon) v_k + epsilon (v_(k-1) + v_(k+1)), cyclic in reading order."""

    name = "crosstalk"
    order = "mixing"
    driver = "static"
    parameters = {"epsilon": Parameter("1", 0.0, -0.25, 0.25, scale=0.02, dense=False)}
    source = "Touch with Insight, § II-D"
    mend = "shield the leads, and look for leakage between neighbouring inputs of the multiplexer"
    finding = (
        "Neighbouring channels leak into each other: each takes up {epsilon:%} of either neighbour."
    )
    shown_by = "a recording with absolute values"
    confusable = ("multiplexer-memory", "adc-nonlinearity")

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        epsilon = setting.values["epsilon"]
        neighbours = np.roll(voltage, 1, axis=1) + np.roll(voltage, -1, axis=1)
        return (1.0 - 2.0 * epsilon) * voltage + epsilon * neighbours
