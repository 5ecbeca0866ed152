"""A skin so thick, or a tank so deep, that current spreads in depth too."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin

DEPTHS_MM = 10.0, 30.0, 100.0  # from that of a skin to that of a tank
CLEAR = 1.2  # times the electrodes' upper end, that a depth to start from has at least


class ThirdDimension(SkinEffect):
    """The disc as a body depth_mm deep, with electrodes of the skin's electrode_height_mm and z.

    Where the thickness is given, it is the depth, and nothing is free.
    """

    name = "third-dimension"
    driver = "static"
    needs = ("electrode_height_mm",)
    parameters = {
        "depth_mm": Parameter("mm", None, 0.1, 1000.0, scale=10.0, dense=False, optional=True)
    }
    source = "Vauhkonen, Vauhkonen, Savolainen, Kaipio 1999"
    mend = "use electrodes that reach through the whole depth"
    finding = "Current spreads in depth too[, through {depth_mm}]."
    shown_by = "absolute values, with electrodes of known height"
    confusable = ("electrode-width",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The thickness given, else depths from that of a skin to that of a tank, in each of which
        the electrodes have room."""
        if skin.thickness_mm is not None:
            return [{}]
        half = 0.5 * (skin.electrode_height_mm or 0.0)
        top = half + (half if skin.electrode_z_mm is None else skin.electrode_z_mm)
        return [{"depth_mm": d} for d in sorted({max(d, CLEAR * top) for d in DEPTHS_MM})]

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as a body."""
        depth = setting.values["depth_mm"]
        return geometry.with_values(
            deep=True, thickness_mm=geometry.thickness_mm if depth is None else depth
        )
