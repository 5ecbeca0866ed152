"""A gain that follows the force."""

import numpy as np

from eitskin.effects.effect import InstrumentEffect, Parameter, Setting


class ForceDependentGain(InstrumentEffect):
    """v -> v (1 + per_N (F - F_mid)); the paper's alpha is 10 N * per_N.

    F_mid is half the largest force of the frames given, unless F_mid_N says otherwise.
    """

    name = "force-dependent-gain"
    driver = "force"
    sites = None
    parameters = {
        "per_N": Parameter("1/N", 0.0, -0.1, 0.1, dense=False),
        "F_mid_N": Parameter("N", None, 0.0, 1000.0, dense=False, optional=True),
    }
    source = "Touch with Insight, § II-D"

    def change(
        self, voltage: np.ndarray, setting: Setting, channels: np.ndarray, force_N: np.ndarray
    ) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M) at the forces (N,)."""
        middle = setting.values["F_mid_N"]
        if middle is None:
            middle = 0.5 * np.nanmax(force_N)
        return voltage * (1.0 + setting.values["per_N"] * (force_N - middle))[:, None]
