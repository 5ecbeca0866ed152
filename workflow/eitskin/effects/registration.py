"""A robot whose origin or direction is not the skin's."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import Frames, Parameter, Setting, TouchEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide, Substitute
from eitskin.physics.outline import is_plain_disc
from eitskin.quantities import number


def _turned_electrodes(registration: NamedEffect, shifted: bool) -> OtherSide | None:
    """Of a disc: all electrodes turned the other way, about touches where they are reported, or
    `shifted` still. Nothing else on the skin may have a direction."""
    if not is_plain_disc(registration.skin):
        return None
    turn_deg = float(registration.values["rotation_deg"])
    low, high = registration.interval("rotation_deg")
    if low <= 0.0 <= high:
        return None
    electrodes = registration.electrodes
    ring = Substitute("electrode-position", {"shift_deg": -turn_deg}, electrodes, "electrodes")
    substitutes, cause = [ring], "The touches may as well be where they are reported"
    if shifted:
        shift = complex(registration.values["dx_mm"], registration.values["dy_mm"])
        shift *= np.exp(-1j * np.radians(turn_deg))
        values = {"dx_mm": shift.real, "dy_mm": shift.imag, "rotation_deg": 0.0}
        substitutes.append(Substitute("registration", values))
        cause = "The touches may as well be shifted alone"
    sentence = (
        f"{cause} and all electrodes turned by {number(-turn_deg)}°. Hold electrode 0 against a"
        " mark on the robot's axis."
    )
    return OtherSide(registration.gap(registration.simulated(substitutes)), sentence)


def turned_electrodes(registration: NamedEffect) -> OtherSide | None:
    """All electrodes turned the other way, about touches where they are reported."""
    return _turned_electrodes(registration, shifted=False)


def turned_electrodes_and_shift(registration: NamedEffect) -> OtherSide | None:
    """All electrodes turned the other way and the touches shifted, where the turn alone is
    distinguishable."""
    turn_alone = turned_electrodes(registration)
    if turn_alone is None or not registration.is_distinct(turn_alone.gap):
        return None
    return _turned_electrodes(registration, shifted=True)


class Registration(TouchEffect):
    """True place = R(rotation) reported + (dx, dy), counter-clockwise about the skin's centre."""

    name = "registration"
    driver = "position"
    parameters = {
        "dx_mm": Parameter("mm", 0.0, -50.0, 50.0, scale=1.0, dense=False),
        "dy_mm": Parameter("mm", 0.0, -50.0, 50.0, scale=1.0, dense=False),
        "rotation_deg": Parameter("°", 0.0, -180.0, 180.0, scale=1.0, dense=False),
    }
    source = "Touch with Insight, § II-B"
    mend = "touch three marks on the skin and fit the robot's frame to them"
    finding = (
        "Touches are not where they are reported[, turned by {rotation_deg}][, shifted by {dx_mm}"
        " along x][, shifted by {dy_mm} along y]."
    )
    shown_by = "touches at known places all over the skin"
    confusable = ("electrode-position",)
    identities = (
        Identity(("electrode-position",), turned_electrodes),
        Identity((), turned_electrodes_and_shift),
    )

    def change(self, touches: pd.DataFrame, setting: Setting, frames: Frames) -> pd.DataFrame:
        """Touches at their true places."""
        angle = np.radians(setting.values["rotation_deg"])
        c, s = np.cos(angle), np.sin(angle)
        x, y = touches["x_mm"], touches["y_mm"]
        return touches.assign(
            x_mm=c * x - s * y + setting.values["dx_mm"],
            y_mm=s * x + c * y + setting.values["dy_mm"],
        )
