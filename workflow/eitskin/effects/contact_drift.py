"""Contacts that change with time."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class ContactDrift(SkinEffect):
    """z_l (1 + per_minute t)."""

    name = "contact-drift"
    driver = "time"
    sites = ("electrodes",)
    on_contacts = True
    parameters = {"per_minute": Parameter("1/min", 0.0, -1.0, 5.0, scale=0.03)}
    source = "Hardman, Thuruthel, Iida 2025"
    mend = "wet and re-seat electrode {site}"
    finding = "The contact impedance of {site} changes by {per_minute:%} per minute."
    shown_by = "a recording of an hour by a measured clock, with absolute values"
    confusable = ("conductivity-drift",)

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry at a moment."""
        impedivity = geometry.contact_impedivity_ohm_m2.copy()
        impedivity[setting.sites] *= 1.0 + setting.values["per_minute"] * moment.minutes
        return geometry.with_values(contact_impedivity_ohm_m2=impedivity)
