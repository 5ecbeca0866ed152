"""The mains, or any other steady tone, in the readings."""

import numpy as np

from eitskin.effects.effect import Frames, InstrumentEffect, Parameter, Setting
from eitskin.errors import InputError


class MainsInterference(InstrumentEffect):
    """v + volt sin(2 pi f t + phase) at the moment the channel is read; volt is the peak."""

    name = "mains-interference"
    order = "mains"
    driver = "time"
    tone = True
    parameters = {
        "frequency_Hz": Parameter("Hz", None, 1e-3, 1e6, scale=1e-3, dense=False),
        "volt": Parameter("V", 0.0, 0.0, 10.0, scale=0.02, dense=False, of_reading=True),
        "phase_deg": Parameter("°", 0.0, -360.0, 360.0, scale=90.0, dense=False, optional=True),
    }
    polar = ("volt", "phase_deg", 1)
    source = "a steady tone, sampled channel by channel"
    mend = "shield the leads, or integrate each reading over whole periods of the mains"
    finding = "A steady tone of {frequency_Hz} is in the readings, {volt} at its peak."
    shown_by = "a recording that says how long a frame takes, with a hundred untouched frames"

    def change(self, voltage: np.ndarray, setting: Setting, frames: Frames) -> np.ndarray:
        """Readings (N, M) of `voltage` (N, M); InputError where nobody knows how long a frame
        takes."""
        if frames.frame_s is None:
            raise InputError("effect mains-interference", "frame_s", "null", "a frame's duration")
        share = np.arange(voltage.shape[1]) / voltage.shape[1]
        time = frames.time_s[:, None] + frames.frame_s * share
        angle = 2.0 * np.pi * setting.values["frequency_Hz"] * time
        tone = np.sin(angle + np.radians(setting.values["phase_deg"]))
        return voltage + setting.values["volt"] * tone
