"""A source that drives against ground, on a skin whose every electrode leaks to it."""

import numpy as np

from eitskin.effects.effect import LeakEffect, Parameter, Setting
from eitskin.physics.skin import Skin

SHARES = 0.01, 0.03, 0.1, 0.3, 1.0  # of a square's conductance, from which fits start


class GroundReturn(LeakEffect):
    """The source's sink is at 0 V, not floating, and each electrode leaks siemens to ground.

    A floating source has readings whose size stays as it is when source and sink are exchanged, and
    so has a grounded sink without leaks. With leaks the current comes back where it likes, which
    shows best in what an amplifier's two inputs have in common.
    """

    name = "ground-return"
    driver = "static"
    parameters = {"siemens": Parameter("S", None, 1e-12, 1.0, scale=1.0, dense=False)}
    grounds_sink = True
    last_resort = {
        "ground-return": (1.0, (0.0,)),
        "common-mode": (300.0, (-3.0, -2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0, 3.0)),
    }
    source = "Zhang, Li 2014"
    mend = "let the source float, or drive two electrodes with opposite currents"
    finding = (
        "The source drives against ground, and each electrode leaks to ground through {siemens}."
    )
    shown_by = "absolute values, every drive with source and sink exchanged too"
    confusable = ("ground-leak", "common-mode")

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """Shares of the skin's own conductance, that of a square of it."""
        assert skin.conductivity_S_per_m is not None
        square = skin.conductivity_S_per_m * 1e-3 * (skin.thickness_mm or 1.0)
        return [{"siemens": share * square} for share in SHARES]

    def admittance(self, setting: Setting, force_N: np.ndarray, terminals: int) -> np.ndarray:
        """(N, terminals) S, the same in every frame and at every electrode."""
        return np.full((len(force_N), terminals), setting.values["siemens"])
