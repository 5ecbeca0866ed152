"""A skin so thick, or a tank so deep, that current spreads in depth too."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.geometry import Geometry
from eitskin.skin import Skin


class ThirdDimension(SkinEffect):
    """The disc as a body depth_mm deep, with electrodes of the skin's electrode_height_mm and z.

    Where the thickness is given, it is the depth, and nothing is free.
    """

    name = "third-dimension"
    driver = "static"
    parameters = {
        "depth_mm": Parameter("mm", None, 0.1, 1000.0, scale=10.0, dense=False, optional=True)
    }
    source = "Vauhkonen, Vauhkonen, Savolainen, Kaipio 1999"
    mend = "use electrodes that reach through the whole depth"
    finding = "Current spreads in depth too[, through {depth_mm}]."
    shown_by = "absolute values, with electrodes of known height"
    confusable = ("electrode-width",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The thickness given, else depths from that of a skin to that of a tank."""
        if skin.thickness_mm is not None:
            return [{}]
        return [{"depth_mm": depth_mm} for depth_mm in (10.0, 30.0, 100.0)]

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as a body."""
        depth = setting.values["depth_mm"]
        return geometry.with_values(
            deep=True, thickness_mm=geometry.thickness_mm if depth is None else depth
        )
