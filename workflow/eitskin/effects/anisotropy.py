"""A gel that conducts better in one direction."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class Anisotropy(SkinEffect):
    """Conductivity along : across the angle is `ratio`, geometric mean kept."""

    name = "anisotropy"
    driver = "static"
    parameters = {
        "ratio": Parameter("1", 1.0, 1.0, 10.0, scale=0.05, dense=False),
        "angle_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False),
    }
    polar = ("ratio", "angle_deg", 2)
    source = "Lionheart 1997"
    mend = "use a gel that was not stretched or poured in one direction"
    finding = "The gel conducts {ratio} times as well along {angle_deg} as across."
    shown_by = "absolute values, with touches at known places all over the skin"
    confusable = ("domain-shape", "ellipse")

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with its conductivity directed."""
        return geometry.with_values(
            anisotropy_ratio=setting.values["ratio"], anisotropy_deg=setting.values["angle_deg"]
        )
