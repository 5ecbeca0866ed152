"""A skin so thick, or a tank so deep, that current spreads in depth too."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin

DEPTHS_MM = 10.0, 30.0, 100.0  # from that of a skin to that of a tank
CLEAR = 1.2  # times the electrodes' upper end, that a depth to start from has at least
SHARES = 0.1, 0.2, 0.4, 0.8, 1.6  # of the radius: depths, where nobody knows the heights either
HEIGHTS = 0.1, 0.25, 0.5, 0.8  # of the depth, from a pad's to those of strips


class ThirdDimension(SkinEffect):
    """The disc as a body depth_mm deep, with electrodes electrode_height_mm high, at the skin's z.

    Where the skin's thickness is given, it is the depth; where its electrodes' height is, it is
    theirs. Where both are, nothing is free.
    """

    name = "third-dimension"
    driver = "static"
    needs = ("electrode_height_mm",)
    parameters = {
        "depth_mm": Parameter("mm", None, 0.1, 1000.0, scale=0.3, dense=False, optional=True),
        "electrode_height_mm": Parameter(
            "mm", None, 0.1, 1000.0, scale=0.3, dense=False, optional=True
        ),
    }
    far = (0.0,)
    source = "Vauhkonen, Vauhkonen, Savolainen, Kaipio 1999"
    mend = "use electrodes that reach through the whole depth"
    finding = (
        "Current spreads in depth too[, through {depth_mm}]"
        "[, from electrodes {electrode_height_mm} high]."
    )
    shown_by = "absolute values, with electrodes of known height"
    confusable = ("electrode-width",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The thickness given, else depths from that of a skin to that of a tank, in each of which
        the electrodes have room; with each, the height given, else some shares of the depth."""
        height, depth = skin.electrode_height_mm, skin.thickness_mm
        half = 0.5 * (height or 0.0)
        top = half + (half if skin.electrode_z_mm is None else skin.electrode_z_mm)
        usual = DEPTHS_MM if height else [share * (skin.radius_mm or 1.0) for share in SHARES]
        depths = [depth] if depth else sorted({max(d, CLEAR * top) for d in usual})
        found = []
        for d in depths:
            own = {} if depth else {"depth_mm": d}
            most = d if skin.electrode_z_mm is None else 2.0 * min(top, d - top)
            heights = [{}] if height else [{"electrode_height_mm": h * most} for h in HEIGHTS]
            found += [own | h for h in heights]
        return found

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as a body."""
        depth, height = (setting.values.get(key) for key in self.parameters)
        return geometry.with_values(
            deep=True,
            thickness_mm=geometry.thickness_mm if depth is None else depth,
            electrode_height_mm=geometry.electrode_height_mm if height is None else height,
        )
