"""A probe that takes current out of the skin."""

import numpy as np

from eitskin.effects.effect import LeakEffect, Parameter, Setting


class IndenterGrounding(LeakEffect):
    """An admittance siemens_per_N F from the contact, spread evenly over it, to ground.

    The contact is one more terminal among the leaks: under a floating source it carries nothing
    unless electrodes leak too.
    """

    name = "indenter-grounding"
    driver = "force"
    on_contact = True
    parameters = {
        "siemens_per_N": Parameter("S/N", 0.0, 0.0, 1.0, scale=5e-3, dense=False, of_reading=True)
    }
    source = "Zimmerman, Smith, Paradiso, Allport, Gershenfeld 1995"
    mend = "insulate the probe's tip, or let it float"
    finding = "The probe takes current out of the skin: it leaks to ground through {siemens_per_N}."
    shown_by = "presses with the source's sink at ground, from light to hard"
    confusable = ("touch-contrast",)

    def admittance(self, setting: Setting, force_N: np.ndarray, terminals: int) -> np.ndarray:
        """(N, terminals) S, at the contact alone."""
        admittance = np.zeros((len(force_N), terminals))
        admittance[:, -1] = setting.values["siemens_per_N"] * force_N
        return admittance
