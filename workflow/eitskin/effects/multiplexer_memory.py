"""A multiplexer that has not settled: part of the last reading is in the next."""

import numpy as np
from scipy.signal import lfilter

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class MultiplexerMemory(InstrumentEffect):
    """y_k = (1 - mu) v_k + mu y_(k-1); y_(-1) is the same frame's last reading.

    The recursion from 0 is z_k; from y_(-1), z_k + mu^(k+1) y_(-1), and its last must be y_(-1).
    """

    name = "multiplexer-memory"
    order = "mixing"
    driver = "scan-order"
    parameters = {"mu": Parameter("1", 0.0, -0.9, 0.9, scale=0.02, dense=False)}
    source = "first-order settling of a scanned input"
    mend = "wait longer after the multiplexer switches"
    finding = "The multiplexer does not settle: {mu:%} of each reading comes from the one before."
    shown_by = "a recording with absolute values"
    confusable = ("crosstalk",)

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        mu = setting.values["mu"]
        from_zero = lfilter([1.0 - mu], [1.0, -mu], voltage, axis=1)
        decay = mu ** np.arange(1.0, voltage.shape[1] + 1.0)
        last = from_zero[:, -1:] / (1.0 - decay[-1])
        return from_zero + decay * last
