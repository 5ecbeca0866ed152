"""A gel that does not answer in proportion to the force."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide
from eitskin.effects.touch_contrast import faulty_load_cell
from eitskin.quantities import number


def bent_load_cell(law: NamedEffect) -> OtherSide:
    """A load cell whose reading goes with a power of the force."""
    exponent = float(law.values["exponent"])
    wording = f"its reading, in newton, to the power of {number(exponent)}"
    return faulty_load_cell(law, law.force_N**exponent, wording)


class ContactLaw(TouchEffect):
    """contrast_per_N F^exponent, F in N; what relaxation has taken off F counts."""

    name = "contact-law"
    driver = "force"
    parameters = {"exponent": Parameter("1", 1.0, 0.1, 3.0, scale=0.2, dense=False)}
    source = "Paredes-Madrid, Palacio, Matute, Parra 2017"
    mend = "calibrate the contrast at several forces"
    finding = "The skin does not answer in proportion to the force, but to its power of {exponent}."
    shown_by = "presses at six forces or more, from light to hard"
    confusable = ("contact-area-growth", "touch-contrast", "force-offset")
    identities = (Identity((), bent_load_cell),)

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches, the force felt raised to its power, its sign kept."""
        effective_N = touches["felt_N"].to_numpy()
        return touches.assign(
            felt_N=np.sign(effective_N) * np.abs(effective_N) ** setting.values["exponent"]
        )
