"""Two wires exchanged."""

import numpy as np

from eitskin.effects.effect import Setting, WiringEffect


class ElectrodeSwap(WiringEffect):
    """Two wires exchanged, for drive and sense alike."""

    name = "electrode-swap"
    order = "swap"
    driver = "static"
    sites = ("electrodes",)
    site_number = 2
    parameters = {}
    source = "pyEIT, issue 95"
    mend = "put the wires of electrodes {site} back in their places"
    finding = "The wires of {site} are exchanged."
    shown_by = "channels that drive and measure every electrode"
    confusable = ("electrode-position",)

    def driven(self, drives: np.ndarray, setting: Setting) -> np.ndarray:
        """The electrodes at the ends of the wires."""
        assert setting.sites is not None
        return _exchanged(drives.max(initial=setting.sites.max()) + 1, setting.sites)[drives]

    def change(
        self,
        potential: np.ndarray,
        setting: Setting,
        drives: np.ndarray,
        impedance: np.ndarray,
        sink_grounded: bool,
    ) -> np.ndarray:
        """Potentials (N, D, n) as the board has them."""
        assert setting.sites is not None
        return potential[:, :, _exchanged(potential.shape[2], setting.sites)]


def _exchanged(n: int, pair: np.ndarray) -> np.ndarray:
    wires = np.arange(n)
    wires[pair] = pair[::-1]
    return wires
