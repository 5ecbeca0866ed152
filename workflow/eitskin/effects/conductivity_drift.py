"""A gel that dries, or warms: its conductivity changes with time."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide
from eitskin.physics.geometry import Geometry
from eitskin.quantities import number


def drifting_gain(drift: NamedEffect) -> OtherSide:
    """A current, or amplifiers, that drift the other way."""
    rate = float(drift.values["per_minute"])
    minutes = drift.time_s / 60.0
    minutes = minutes - minutes[0]
    voltage = drift.simulated() / (1.0 + rate * minutes)[:, None]
    sentence = (
        f"Instead the current, or all amplifiers, may drift by {number(-100.0 * rate)} % per"
        " minute. Record a known resistor for as long."
    )
    return OtherSide(drift.gap(voltage), sentence)


class ConductivityDrift(SkinEffect):
    """sigma (1 + per_minute t)."""

    name = "conductivity-drift"
    driver = "time"
    parameters = {"per_minute": Parameter("1/min", 0.0, -1.0, 1.0, scale=0.01, dense=False)}
    source = "Hardman, Thuruthel, Iida 2025"
    mend = "let it settle, and keep it from drying and from warming"
    finding = "The skin's conductivity changes by {per_minute:%} per minute."
    shown_by = "a recording of an hour by a measured clock, with untouched frames throughout"
    confusable = ("contact-drift",)
    identities = (Identity((), drifting_gain),)

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry at a moment."""
        factor = 1.0 + setting.values["per_minute"] * moment.minutes
        return geometry.with_values(conductivity_S_per_m=geometry.conductivity_S_per_m * factor)
