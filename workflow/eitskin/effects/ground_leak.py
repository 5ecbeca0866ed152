"""Electrodes that leak to ground."""

import numpy as np

from eitskin.effects.effect import LeakEffect, Parameter, Setting


class GroundLeak(LeakEffect):
    """An admittance from each named electrode to ground, as `leaks` has them: under a floating
    source one alone carries nothing."""

    name = "ground-leak"
    driver = "static"
    sites = ("electrodes",)
    parameters = {"siemens": Parameter("S", 0.0, 0.0, 1.0, scale=0.02, of_reading=True)}
    source = "Zhang, Li 2014"
    mend = "dry and insulate the lead of electrode {site}"
    finding = "{site} {leaks|leak} to ground through {siemens}."
    shown_by = "absolute values, with the source's sink at ground"
    confusable = ("offset", "ground-return")

    def admittance(self, setting: Setting, force_N: np.ndarray, terminals: int) -> np.ndarray:
        """(N, terminals) S, the same in every frame."""
        admittance = np.zeros((len(force_N), terminals))
        admittance[:, setting.sites] = setting.values["siemens"]
        return admittance
