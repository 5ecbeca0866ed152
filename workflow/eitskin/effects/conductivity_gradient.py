"""A gel that conducts better on one side: a tilt of its thickness or of its salt."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class ConductivityGradient(SkinEffect):
    """sigma (1 + relative_across (r . n) / 2R), rising towards the angle."""

    name = "conductivity-gradient"
    driver = "static"
    on_outlines = False
    beside_inner = False
    parameters = {
        "relative_across": Parameter("1", 0.0, 0.0, 1.5, scale=0.05, dense=False),
        "angle_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False),
    }
    polar = ("relative_across", "angle_deg", 1)
    source = "Lionheart 2004"
    mend = "level the skin while it sets, and keep it evenly moist"
    finding = (
        "The skin's conductivity rises by {relative_across:%} across the skin, towards {angle_deg}."
    )
    shown_by = "a recording with absolute values"
    confusable = ("conductivity-patch",)

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with this gradient added to what it has."""
        values = (setting.values["relative_across"], setting.values["angle_deg"])
        present, added = (
            across * np.exp(1j * np.radians(angle))
            for across, angle in ((geometry.gradient_across, geometry.gradient_deg), values)
        )
        gradient = present + added
        return geometry.with_values(
            gradient_across=float(np.abs(gradient)),
            gradient_deg=float(np.degrees(np.angle(gradient))),
        )
