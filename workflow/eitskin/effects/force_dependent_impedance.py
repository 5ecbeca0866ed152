"""Contacts that change while the skin is pressed."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin


class ForceDependentImpedance(SkinEffect):
    """z_l (1 + per_N F w_l); w_l = 1, or exp(-(d_l / range)^2) where a range is given.

    d_l: from the electrode's centre to the contact's.
    """

    name = "force-dependent-impedance"
    driver = "force"
    sites = ("electrodes",)
    on_contacts = True
    parameters = {
        "per_N": Parameter("1/N", 0.0, -0.1, 10.0, scale=0.05),
        "range_mm": Parameter("mm", None, 0.1, 1e4, scale=20.0, dense=False, optional=True),
    }
    source = "Touch with Insight, § II-D"
    mend = "re-seat electrode {site} so that pressing does not move it"
    finding = (
        "The contact impedance of {site} changes by {per_N:%} per newton[, for touches within"
        " about {range_mm}]."
    )
    shown_by = "absolute values, with light and hard presses near every electrode"
    confusable = ("force-dependent-gain",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """Everywhere alike, or within a range of the touch."""
        return [{}, *({"range_mm": range_mm} for range_mm in (15.0, 30.0, 60.0))]

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with contacts as the force has them; untouched, as they were."""
        if moment.force_N == 0:
            return geometry
        assert setting.sites is not None
        weight = np.ones(len(setting.sites))
        if setting.values["range_mm"] is not None:
            centre = geometry.electrode_place[setting.sites]
            distance_mm = np.abs(centre - complex(moment.x_mm, moment.y_mm))
            weight = np.exp(-((distance_mm / setting.values["range_mm"]) ** 2))
        impedivity = geometry.contact_impedivity_ohm_m2.copy()
        impedivity[setting.sites] *= 1.0 + setting.values["per_N"] * moment.force_N * weight
        return geometry.with_values(contact_impedivity_ohm_m2=impedivity)
