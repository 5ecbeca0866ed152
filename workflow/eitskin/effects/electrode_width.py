"""Electrodes wider or narrower than the drawing has them."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin


class ElectrodeWidth(SkinEffect):
    """Arc length of some electrodes, or of all."""

    name = "electrode-width"
    driver = "static"
    sites = ("electrodes",)
    parameters = {"width_mm": Parameter("mm", None, 0.1, 100.0, scale=1.0)}
    source = "Boyle, Adler 2011"
    mend = "measure the width of electrode {site}"
    finding = "{site} {is|are} {width_mm} wide, unlike in the drawing."
    shown_by = "absolute values, with the driven electrodes measured too"
    confusable = ("contact-impedance", "third-dimension")
    far = (-0.7, 0.0, 0.5, 0.8, 1.0, 1.2, 1.35)

    def neutral(self, key: str, skin: Skin) -> float | None:
        """The width believed."""
        return skin.electrode_width_mm

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with widths replaced."""
        width = geometry.electrode_width_mm.copy()
        width[setting.sites] = setting.values["width_mm"]
        return geometry.with_values(electrode_width_mm=width)
