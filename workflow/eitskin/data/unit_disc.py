"""A skin as the unit disc onto which it maps conformally.

Readings of point electrodes on a homogeneous sheet are those of the disc with the electrodes where
the map brings them; the sensitivity at a place is the disc's times the square of the map's slope.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.forward import disc_map
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import inside_mm, laid_out
from eitskin.physics.skin import Skin


@dataclass(frozen=True)
class UnitDisc:
    """Angles of the electrodes (n,) on the unit disc in degrees, and the map of complex places in
    mm: their images, and the map's slopes in 1/mm."""

    electrode_deg: np.ndarray
    geometry: Geometry | None
    radius_mm: float

    def mapped(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Images of complex places z (K,), mm, on the disc, and moduli (K,) of the slopes, 1/mm."""
        if self.geometry is None:
            return z / self.radius_mm, np.full(np.shape(z), 1.0 / self.radius_mm)
        image, slope = disc_map(self.geometry).derivatives(z, 1)
        return image, np.abs(slope)


def unit_disc(skin: Skin) -> UnitDisc:
    """The disc of a skin; of a disc without its radius, with places in radii. Raises InputError
    where the electrodes' places are not stated or inside, and for an outline that cannot be
    mapped."""
    if inside_mm(skin) is not None:
        actual, expected = "electrodes inside the skin", "all on its rim, to place touches"
        raise InputError("recording", "skin.electrode_xy_mm", actual, expected)
    if skin.rim is None:
        if skin.electrode_deg is None:
            expected = "the electrodes' angles, to place touches"
            raise InputError("recording", "skin.electrode_deg", "null", expected)
        return UnitDisc(np.array(skin.electrode_deg), None, skin.radius_mm or 1.0)
    rim = laid_out(skin)
    assert rim.electrode_deg is not None and rim.radius_mm is not None
    angle, nothing = np.array(rim.electrode_deg), np.zeros(len(rim.electrode_deg))
    geometry = Geometry(rim.radius_mm, 1.0, 1.0, angle, nothing, nothing, outline=skin.rim)
    image = disc_map(geometry)(geometry.rim(np.radians(angle)))
    return UnitDisc(np.degrees(np.angle(image)) % 360.0, geometry, rim.radius_mm)


def electrode_deg(skin: Skin) -> list[float] | None:
    """Angles of a skin's electrodes on the unit disc in degrees; None where their places are not
    stated, or inside. Raises InputError for an outline that cannot be mapped."""
    if inside_mm(skin) is not None:
        return None
    if skin.rim is not None or skin.electrode_deg is not None:
        return unit_disc(skin).electrode_deg.tolist()
    return None
