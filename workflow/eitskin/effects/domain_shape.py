"""A rim that is no circle."""

import numpy as np

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin

HARMONICS = 6


class DomainShape(SkinEffect):
    """r(phi) = R (1 + amplitude cos(harmonic phi - phase)); electrode edges keep their angles.

    One entry a harmonic; harmonic 0 is the size.
    """

    name = "domain-shape"
    driver = "static"
    several = True
    parameters = {
        "harmonic": Parameter("1", None, 0, 16, dense=False, whole=True),
        "amplitude": Parameter("1", 0.0, 0.0, 0.3, scale=0.02, dense=False),
        "phase_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False),
    }
    polar = ("amplitude", "phase_deg", 1)
    source = "Nissinen, Kolehmainen, Kaipio 2011"
    mend = "measure the rim"
    finding = (
        "The rim is no circle: harmonic {harmonic} of its radius has an amplitude of"
        " {amplitude:%} and a phase of {phase_deg}."
    )
    shown_by = "absolute values, with touches at known places along the rim"
    confusable = ("anisotropy", "ellipse", "electrode-position", "conductivity-patch")

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """The size and the harmonics that a rim is likely to have."""
        return [{"harmonic": k} for k in range(HARMONICS + 1)]

    def finding_at(self, values: dict) -> str:
        """Harmonic 0 is no shape."""
        if values["harmonic"] > 0:
            return self.finding
        larger = np.cos(np.radians(values["phase_deg"])) > 0
        return f"The skin is {{amplitude:%}} {'larger' if larger else 'smaller'} than it should be."

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry with this harmonic added to its rim."""
        k = int(setting.values["harmonic"])
        amplitude, phase = setting.values["amplitude"], np.radians(setting.values["phase_deg"])
        cosines, sines = dict(geometry.shape_cos), dict(geometry.shape_sin)
        cosines[k] = cosines.get(k, 0.0) + amplitude * np.cos(phase)
        if k > 0:
            sines[k] = sines.get(k, 0.0) + amplitude * np.sin(phase)
        return geometry.with_values(shape_cos=cosines, shape_sin=sines)
