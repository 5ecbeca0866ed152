"""A skin so thick, or a tank so deep, that current spreads in depth too."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin

DEPTHS_MM = 10.0, 30.0, 100.0  # from that of a skin to that of a tank
CLEAR = 1.2  # times the electrodes' upper end, that a depth to start from has at least
SHARES = 0.1, 0.3, 1.0  # of the radius: depths, where nobody knows the heights either
HEIGHTS = 0.1, 0.3, 0.8  # of the depth, from a pad's to those of strips
# Of the depth: where electrodes that have room there are in the middle. Not half of it: there up
# and down are the same, and no slope would lead away.
PLACES = 0.2, 0.35


class ThirdDimension(SkinEffect):
    """The disc as a body depth_mm deep, with electrodes electrode_height_mm high, their middle
    electrode_z_mm above its bottom, or as far below its top, which reads the same.

    What the skin's owner knows of these is not free: thickness_mm is the depth.
    """

    name = "third-dimension"
    driver = "static"
    needs = ("electrode_height_mm",)
    parameters = {
        "depth_mm": Parameter("mm", None, 0.1, 1000.0, scale=0.3, dense=False, optional=True),
        "electrode_height_mm": Parameter(
            "mm", None, 0.1, 1000.0, scale=0.3, dense=False, optional=True
        ),
        "electrode_z_mm": Parameter(
            "mm", None, 0.05, 1000.0, scale=0.3, dense=False, optional=True
        ),
    }
    far = (0.0,)
    body = True
    source = "Vauhkonen, Vauhkonen, Savolainen, Kaipio 1999"
    mend = "use electrodes that reach through the whole depth"
    finding = (
        "Current spreads in depth too[, through {depth_mm}]"
        "[, from electrodes {electrode_height_mm} high]"
        "[, the electrodes' middle {electrode_z_mm} above its bottom or below its top]."
    )
    shown_by = "absolute values, with electrodes of known height"
    confusable = ("electrode-width",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The thickness given, else depths from that of a skin to that of a tank, in each of which
        the electrodes have room; with each, the height given, else some shares of the depth; with
        both, the place given, else some where such electrodes have room."""
        height, z = skin.electrode_height_mm, skin.electrode_z_mm
        half = 0.5 * (height or 0.0)
        top = half + (half if z is None else z)
        usual = DEPTHS_MM if height else [share * (skin.radius_mm or 1.0) for share in SHARES]
        depths = [skin.thickness_mm] if skin.thickness_mm else {max(d, CLEAR * top) for d in usual}
        found = []
        for d in sorted(depths):
            own = {} if skin.thickness_mm else {"depth_mm": d}
            most = d if z is None else 2.0 * min(top, d - top)
            for h in [height] if height else [share * most for share in HEIGHTS]:
                tall = own if height else own | {"electrode_height_mm": h}
                room = [] if z is not None else [p * d for p in PLACES if p * d >= 0.5 * h]
                found += [tall | {"electrode_z_mm": place} for place in room] or [tall]
        return found

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as a body."""
        own = {"thickness_mm": setting.values.get("depth_mm")}
        own |= {key: setting.values.get(key) for key in ("electrode_height_mm", "electrode_z_mm")}
        known = {key: value for key, value in own.items() if value is not None}
        return geometry.with_values(deep=True, **known)
