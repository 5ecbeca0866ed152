"""The paper's geometry mismatch: a skin stretched along its axes."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class Ellipse(SkinEffect):
    """(x, y) -> (sx x, sy y) of the rim, the electrodes carried along; touches keep their place.

    To first order domain-shape 0 and 2 with electrode-position -1/2 (sx - sy) sin 2 phi.
    """

    name = "ellipse"
    driver = "static"
    parameters = {
        "sx": Parameter("1", 1.0, 0.5, 2.0, scale=0.03, dense=False),
        "sy": Parameter("1", 1.0, 0.5, 2.0, scale=0.03, dense=False),
    }
    composite = True
    source = "Touch with Insight, § II-D"
    mend = "measure the rim"
    finding = "The skin is stretched {sx} times along x and {sy} times along y, electrodes and all."
    shown_by = "absolute values, with touches at known places along the rim"
    confusable = ("domain-shape", "anisotropy", "electrode-position")

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The stretched geometry."""
        return geometry.with_values(
            stretch_x=geometry.stretch_x * setting.values["sx"],
            stretch_y=geometry.stretch_y * setting.values["sy"],
        )
