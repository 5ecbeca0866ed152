"""Electrodes that touch the gel worse, or better, than believed."""

from eitskin.effects.domain_shape import DomainShape
from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.effects.gain import EVERY_GAIN, scaled_readings
from eitskin.effects.identity import Identity, NamedEffect, OtherSide, Substitute
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import is_plain_disc
from eitskin.quantities import number


def scaled_currents(contacts: NamedEffect) -> OtherSide | None:
    """Of contacts all alike: all currents, or all amplifiers, and the conductivity with them."""
    if contacts.scope != "common":
        return None
    return scaled_readings(contacts, float(contacts.values["ratio"]))


def scaled_rim(contacts: NamedEffect) -> OtherSide | None:
    """Of contacts all alike: the size of the skin, its electrodes' angles kept."""
    if contacts.scope != "common" or not is_plain_disc(contacts.skin):
        return None
    ratio = float(contacts.values["ratio"])
    growth = 1.0 / ratio - 1.0
    if abs(growth) > DomainShape.parameters["amplitude"].high:
        return None
    phase_deg = 0.0 if growth > 0 else 180.0
    values = {"harmonic": 0, "amplitude": abs(growth), "phase_deg": phase_deg}
    radius_mm = contacts.skin.radius_mm
    assert radius_mm is not None
    diameter_mm = 2.0 * radius_mm / ratio
    sentence = f"Instead the skin may be {number(diameter_mm)} mm across. Measure it with a ruler."
    voltage = contacts.simulated([Substitute("domain-shape", values)])
    return OtherSide(contacts.gap(voltage), sentence)


class ContactImpedance(SkinEffect):
    """z_l * ratio."""

    name = "contact-impedance"
    driver = "static"
    sites = ("electrodes",)
    on_contacts = True
    scaled_attribute = "contact_impedivity_ohm_m2"
    parameters = {"ratio": Parameter("1", 1.0, 1e-3, 1e3)}
    source = "Cheng, Isaacson, Newell, Gisser 1989"
    mend = "clean and re-seat electrode {site}"
    finding = "{site} {has|have} {ratio} times the contact impedance that the simulation assumes."
    shown_by = "absolute values, with the driven electrodes measured too"
    confusable = ("electrode-width", "electrode-open")
    identities = (
        Identity(EVERY_GAIN, scaled_currents),
        Identity(("domain-shape",), scaled_rim),
    )

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with contact impedivities multiplied."""
        impedivity = geometry.contact_impedivity_ohm_m2.copy()
        impedivity[setting.sites] *= setting.values["ratio"]
        return geometry.with_values(contact_impedivity_ohm_m2=impedivity)
