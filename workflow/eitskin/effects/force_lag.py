"""A load cell that is late."""

from eitskin.effects.effect import ForceEffect, Parameter, Setting
from eitskin.physics.force_history import ForceHistory


class ForceLag(ForceEffect):
    """The force reported is the force so long ago: true(t) = reported(t + lag)."""

    name = "force-lag"
    driver = "time"
    parameters = {"lag_s": Parameter("s", 0.0, -5.0, 5.0, scale=0.1, dense=False)}
    source = "clocks of load cell and board"
    mend = "give load cell and board one clock"
    finding = "The load cell is {lag_s} late."
    opposite = ("late", "early")
    shown_by = "presses whose force rises and falls fast, with several frames in each"
    confusable = ("hysteresis", "relaxation", "frame-skew")

    def change(self, history: ForceHistory, setting: Setting) -> ForceHistory:
        """The true force, of the force reported."""
        return history.advanced(setting.values["lag_s"])
