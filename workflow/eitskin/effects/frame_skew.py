"""Channels that are read one after another while the force changes."""

import numpy as np

from eitskin.effects.effect import ClockEffect, Frames, Parameter, Setting


class FrameSkew(ClockEffect):
    """Force F + fraction step (zeta - 1/2) at zeta, 0 at a frame's first channel, 1 at its last.

    step: the mean of the steps to the frames before and after in the press, one-sided at its ends,
    0 in a press of one frame. Below 0 it is 0: the press has not begun, or is over.
    """

    name = "frame-skew"
    driver = "scan-order"
    parameters = {"fraction": Parameter("1", 0.0, -1.0, 1.0, scale=0.1, dense=False)}
    source = "Yerworth, Bayford 2013"
    mend = "hold the force while a frame is read"
    finding = (
        "A frame's channels do not see one force: from its first to its last, {fraction:%} of the"
        " step from frame to frame goes by."
    )
    shown_by = "presses whose force rises and falls fast, with several frames in each"
    confusable = ("hysteresis", "force-lag")

    def force_shift(self, setting: Setting, frames: Frames) -> np.ndarray:
        """(N,) N: force at the frame's last channel minus that at its first."""
        assert frames.history is not None
        step = np.zeros(len(frames.force_N))
        for rows in frames.history.rows:
            steps = np.diff(frames.force_N[rows])
            if len(steps):
                backward, forward = np.append(steps[0], steps), np.append(steps, steps[-1])
                step[rows] = 0.5 * (backward + forward)
        return setting.values["fraction"] * step
