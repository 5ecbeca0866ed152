"""A gel that dries, or warms: its conductivity changes with time."""

from eitskin.effects.effect import Parameter, Setting, SkinEffect
from eitskin.geometry import Geometry


class ConductivityDrift(SkinEffect):
    """sigma (1 + per_minute t)."""

    name = "conductivity-drift"
    driver = "time"
    sites = None
    parameters = {"per_minute": Parameter("1/min", 0.0, -0.1, 0.1, dense=False)}
    source = "Hardman, Thuruthel, Iida 2025"

    def change(self, geometry: Geometry, setting: Setting, minutes: float) -> Geometry:
        """The geometry `minutes` after the start."""
        factor = 1.0 + setting.values["per_minute"] * minutes
        return geometry.with_values(conductivity_S_per_m=geometry.conductivity_S_per_m * factor)
