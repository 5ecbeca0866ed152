"""A converter that bends, or that is full."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting
from eitskin.physics.skin import Skin


class AdcNonlinearity(InstrumentEffect):
    """v + cubic v^3, and clipped at +- limit_V where one is given."""

    name = "adc-nonlinearity"
    order = "converter"
    driver = "amplitude"
    either = ("cubic", "limit_V")
    parameters = {
        "cubic": Parameter(
            "1/V²", 0.0, -1e6, 1e6, scale=0.02, dense=False, optional=True, of_reading=True
        ),
        "limit_V": Parameter(
            "V", None, 1e-9, 1e3, scale=0.1, dense=False, optional=True, of_reading=True
        ),
    }
    source = "third-order term and full scale of a converter's data sheet"
    mend = "lower the current until every channel stays within the converter's range"
    finding = (
        "The converter distorts large readings[; it adds {cubic} times their cube][; beyond"
        " ±{limit_V} it is full]."
    )
    shown_by = (
        "a recording with absolute values at several currents, the largest near the converter's"
        " range"
    )
    confusable = ("crosstalk",)

    def starts(self, skin: Skin, recorded_V: np.ndarray) -> list[dict[str, float]]:
        """A bend, or a limit below the largest readings."""
        largest = np.nanmax(np.abs(recorded_V))
        return [{}, *({"cubic": 0.0, "limit_V": share * largest} for share in (0.98, 0.85))]

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M)."""
        voltage = voltage + setting.values["cubic"] * voltage**3
        limit = setting.values["limit_V"]
        return voltage if limit is None else np.clip(voltage, -limit, limit)
