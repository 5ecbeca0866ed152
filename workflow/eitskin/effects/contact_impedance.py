"""Electrodes that touch the gel worse, or better, than believed."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class ContactImpedance(SkinEffect):
    """z_l * ratio."""

    name = "contact-impedance"
    driver = "static"
    sites = ("electrodes",)
    on_contacts = True
    scaled_attribute = "contact_impedivity_ohm_m2"
    parameters = {"ratio": Parameter("1", 1.0, 1e-3, 1e3)}
    source = "Cheng, Isaacson, Newell, Gisser 1989"
    mend = "re-seat electrode {site}"
    finding = (
        "{site} {touches|touch} the gel through {ratio} times the contact impedance that the"
        " simulation assumes."
    )
    shown_by = "absolute values, with the driven electrodes measured too"
    confusable = ("electrode-width", "electrode-open")

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with contact impedivities multiplied."""
        impedivity = geometry.contact_impedivity_ohm_m2.copy()
        impedivity[setting.sites] *= setting.values["ratio"]
        return geometry.with_values(contact_impedivity_ohm_m2=impedivity)
