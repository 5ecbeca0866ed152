"""A rim that is no circle."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.geometry import Geometry
from eitskin.skin import Skin

HARMONICS = 6


class DomainShape(SkinEffect):
    """r(phi) = R (1 + amplitude cos(harmonic phi - phase)); electrode edges keep their angles.

    One entry a harmonic; harmonic 0 is the size.
    """

    name = "domain-shape"
    driver = "static"
    parameters = {
        "harmonic": Parameter("1", None, 0, 16, dense=False, whole=True),
        "amplitude": Parameter("1", 0.0, 0.0, 0.3, scale=0.02, dense=False),
        "phase_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False),
    }
    polar = ("amplitude", "phase_deg", 1)
    source = "Nissinen, Kolehmainen, Kaipio 2011"
    mend = "measure the rim"
    confusable = ("anisotropy", "ellipse", "electrode-position", "conductivity-patch")

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The size and the harmonics that a rim is likely to have."""
        return [{"harmonic": k} for k in range(HARMONICS + 1)]

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with this harmonic added to its rim."""
        k = int(setting.values["harmonic"])
        amplitude, phase = setting.values["amplitude"], np.radians(setting.values["phase_deg"])
        cosines, sines = dict(geometry.shape_cos), dict(geometry.shape_sin)
        cosines[k] = cosines.get(k, 0.0) + amplitude * np.cos(phase)
        if k > 0:
            sines[k] = sines.get(k, 0.0) + amplitude * np.sin(phase)
        return geometry.with_values(shape_cos=cosines, shape_sin=sines)
