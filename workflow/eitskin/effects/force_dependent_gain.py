"""A gain that follows the force."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class ForceDependentGain(InstrumentEffect):
    """v -> v (1 + per_N (F - F_mid)); the paper's alpha is 10 N * per_N.

    F_mid is half the recording's largest force, unless F_mid_N says otherwise.
    """

    name = "force-dependent-gain"
    order = "gain"
    driver = "force"
    parameters = {
        "per_N": Parameter("1/N", 0.0, -0.1, 0.1, scale=5e-3, dense=False),
        "F_mid_N": Parameter("N", None, 0.0, 1000.0, scale=5.0, dense=False, optional=True),
    }
    source = "Touch with Insight, § II-D"
    mend = "check the amplifier's supply while the skin is pressed"
    finding = "The gain of all channels changes by {per_N:%} per newton[ away from {F_mid_N}]."
    shown_by = "a recording with absolute values, with presses from light to hard"
    confusable = ("force-dependent-impedance",)

    def recorded_values(self, force_max_N: float) -> dict[str, float]:
        """The middle force, which another recording may have elsewhere."""
        return {"F_mid_N": 0.5 * force_max_N}

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        middle = setting.values["F_mid_N"]
        if middle is None:
            middle = self.recorded_values(frames.force_max_N)["F_mid_N"]
        force = frames.force_N[:, None] if frames.seen_N is None else frames.seen_N
        return voltage * (1.0 + setting.values["per_N"] * (force - middle))
