"""A skin so thick, or a tank so deep, that current spreads in depth too."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin

# Depths, heights and places from which fits start.
DEPTHS_MM = 10.0, 30.0, 100.0  # from the depth of a skin to that of a tank
DEPTH_FACTOR = 1.2  # least depth over the upper end of the electrodes
RADIUS_SHARES = 0.1, 0.3, 1.0  # depths over the radius, for unknown heights
HEIGHTS = 0.1, 0.3, 0.8  # heights over the depth, from a pad's to those of strips
# Places of the electrodes' middle over the depth. Half of it is a symmetric point, at which the
# slope is 0.
PLACE_SHARES = 0.2, 0.35


class ThirdDimension(SkinEffect):
    """The disc as a body depth_mm deep, with electrodes electrode_height_mm high, their middle
    electrode_z_mm above its bottom, or as far below its top, which reads the same.

    What the skin's owner knows of these is not free: thickness_mm is the depth.
    """

    name = "third-dimension"
    driver = "static"
    on_outlines = False
    beside_inner = False
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
    source = "Vauhkonen, Vauhkonen, Savolainen, Kaipio 1999"
    mend = "use electrodes that reach through the whole depth"
    finding = (
        "Current spreads in depth too[, through {depth_mm}]"
        "[, from electrodes {electrode_height_mm} high]"
        "[, the electrodes' middle {electrode_z_mm} above the bottom, or below the top]."
    )
    shown_by = "absolute values, with electrodes of known height"
    confusable = ("electrode-width",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """Starting values: the depth, unless the thickness is stated; with each the height,
        unless it is stated, as shares of the depth; with both the place, unless it is stated,
        where such electrodes fit."""
        height, z = skin.electrode_height_mm, skin.electrode_z_mm
        half = 0.5 * (height or 0.0)
        top = half + (half if z is None else z)
        typical = DEPTHS_MM if height else [s * (skin.radius_mm or 1.0) for s in RADIUS_SHARES]
        depths = {max(depth, DEPTH_FACTOR * top) for depth in typical}
        starts = []
        for depth in [skin.thickness_mm] if skin.thickness_mm else sorted(depths):
            start = {} if skin.thickness_mm else {"depth_mm": depth}
            largest = depth if z is None else 2.0 * min(top, depth - top)
            for h in [height] if height else [share * largest for share in HEIGHTS]:
                height_start = start if height else start | {"electrode_height_mm": h}
                places = [p * depth for p in PLACE_SHARES if z is None and p * depth >= 0.5 * h]
                starts += [height_start | {"electrode_z_mm": place} for place in places] or [
                    height_start
                ]
        return starts

    def largest_body(self, geometry: Geometry) -> Geometry | None:
        """The body with the highest electrodes that are tried, unless their height is stated; None
        on an outline."""
        if geometry.outline is not None:
            return None
        height = geometry.electrode_height_mm or HEIGHTS[-1] * geometry.thickness_mm
        return geometry.with_values(deep=True, electrode_height_mm=height)

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as a body."""
        keys = ("electrode_height_mm", "electrode_z_mm")
        values = {"thickness_mm": setting.values.get("depth_mm")}
        values |= {key: setting.values.get(key) for key in keys}
        stated = {key: value for key, value in values.items() if value is not None}
        return geometry.with_values(deep=True, **stated)
