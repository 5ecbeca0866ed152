"""A multiplexer that has not settled: part of the last reading is in the next."""

import numpy as np
from scipy.linalg import circulant

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting


class MultiplexerMemory(InstrumentEffect):
    """y_k = (1 - mu) v_k + mu y_(k-1); y_(-1) is the same frame's last reading.

    Closed on itself like this, the recursion is a circulant matrix: of the reading j places before
    k, (1 - mu) mu^j / (1 - mu^M) is in y_k.
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
        share = (1.0 - mu) * mu ** np.arange(voltage.shape[1]) / (1.0 - mu ** voltage.shape[1])
        return voltage @ circulant(share).T
