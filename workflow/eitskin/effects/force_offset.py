"""A load cell whose zero is not 0."""

from eitskin.effects.effect import ForceEffect, Parameter, Setting
from eitskin.physics.force_history import ForceHistory


class ForceOffset(ForceEffect):
    """True force = reported + offset while touched, never below 0."""

    name = "force-offset"
    driver = "force"
    parameters = {"offset_N": Parameter("N", 0.0, -5.0, 5.0, scale=0.1, dense=False)}
    source = "zero of a load cell"
    mend = "zero the load cell"
    finding = (
        "The load cell's zero is off: while the skin is touched, the force is {offset_N} more"
        " than reported."
    )
    opposite = ("more", "less")
    shown_by = "presses at many light forces"
    confusable = ("contact-law", "touch-contrast")

    def change(self, history: ForceHistory, setting: Setting) -> ForceHistory:
        """The true force, of the force reported."""
        return history.offset(setting.values["offset_N"])
