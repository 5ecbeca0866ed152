"""Electrodes that are not where the drawing has them."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class ElectrodePosition(SkinEffect):
    """electrode_deg + shift. Dense it is the paper's electrode jitter."""

    name = "electrode-position"
    driver = "static"
    sites = ("electrodes",)
    common = False  # that turns the skin, as the registration does
    parameters = {"shift_deg": Parameter("°", 0.0, -20.0, 20.0, scale=0.5)}
    source = "Touch with Insight, § II-D"
    mend = "measure the angle of electrode {site}"
    finding = (
        "{site} {sits|sit} {shift_deg} from where the drawing has {it|them}, towards larger angles."
    )
    shown_by = "a recording with absolute values"
    confusable = ("domain-shape", "ellipse", "electrode-swap", "registration")

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with electrodes shifted."""
        angle = geometry.electrode_deg.copy()
        angle[setting.sites] += setting.values["shift_deg"]
        return geometry.with_values(electrode_deg=angle)
