"""A broken wire."""

import numpy as np

from eitskin.effects.effect import Setting, WiringEffect


class ElectrodeOpen(WiringEffect):
    """I_l = 0: a drive through it drives nothing, the electrode stays on the skin as a contact.

    The board reads the mean of the other electrodes' potentials for it; of point electrodes, of
    those that do not drive, whose own potential has no bound.
    """

    name = "electrode-open"
    order = "open"
    driver = "static"
    sites = ("electrodes",)
    parameters = {}
    source = "Asfaw, Adler 2005; Hartinger, Guardo, Adler, Gagnon 2009"
    mend = "mend the wire of electrode {site}"
    finding = "{site} {is|are} not connected: no current flows through {its|their} {wire|wires}."
    shown_by = "channels that drive and measure every electrode"
    confusable = ("contact-impedance",)

    def change(
        self,
        potential: np.ndarray,
        setting: Setting,
        drives: np.ndarray,
        impedance: np.ndarray,
        sink_grounded: bool,
    ) -> np.ndarray:
        """Potentials (N, D, n) that the board has."""
        assert setting.sites is not None
        changed = potential.copy()
        for site in setting.sites:
            changed[:, :, site] = np.nanmean(np.delete(potential, site, axis=2), axis=2)
        changed[:, np.isin(drives, setting.sites).any(axis=1)] = 0.0
        return changed
