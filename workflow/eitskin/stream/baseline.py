"""The untouched level of a stream: the mean of its opening frames times a common gain.

Nothing but the gain is tracked. A gain of all readings is what a drift of the conductivity does and
no touch; any other slow change may be a slow press, and is compared with the opening frames like a
quick one.
"""

import numpy as np

from eitskin.exported.channels import Channels

OPENING_FRAMES = 10  # their mean adds 5 % to the noise of a change
MAX_DRIFT_PER_S = 0.02 / 60.0  # water's conductivity rises by 2 % a K, a skin's by 1 K a minute
MAX_GAIN = 0.1  # since the opening frames, by 5 K; beyond, the model was trained on another skin


class Baseline:
    """The untouched `level` (M,): the mean of the opening frames (n, M), NaN where never read.

    `gain` is the relative change of all readings since, last updated at `time_s`.
    """

    def __init__(
        self, opening_frames: np.ndarray, time_s: float, channels: Channels, scale: np.ndarray
    ):
        is_read = np.isfinite(opening_frames)
        self._count = is_read.sum(axis=0)
        self._total = np.where(is_read, opening_frames, 0.0).sum(axis=0)
        self._channels, self._scale = channels, scale
        self._weights: dict[tuple, np.ndarray] = {}
        self.gain, self.time_s = 0.0, time_s
        self._update_level()

    def _update_level(self) -> None:
        count = np.where(self._count > 0, self._count, np.nan)
        self.level = self._total / count
        self._weights.clear()

    def change(self, reading: np.ndarray) -> np.ndarray:
        """The change (M,) of a reading (M,): reading / (1 + gain) - level."""
        return reading / (1.0 + self.gain) - self.level

    def common_gain(self, change: np.ndarray) -> float:
        """The common gain in a change (M,), by generalised least squares (Aitken 1935).

        The covariance is that of touches of the same strength, so that a touch is no gain.
        """
        scaled = change / self._scale
        missing_channels = tuple(np.flatnonzero(np.isnan(scaled)).tolist())
        key = self._channels.strength_class(scaled), missing_channels
        if key not in self._weights:
            self._weights[key] = self._channels.pattern_weights(self.level / self._scale, *key)
        return float(np.nan_to_num(scaled) @ self._weights[key])

    def drift_gain(self, gain: float, time_s: float) -> float:
        """The part of a new common gain that a drift since the last update can explain."""
        max_step = MAX_DRIFT_PER_S * max(time_s - self.time_s, 0.0)
        stepped_gain = (1.0 + self.gain) * (1.0 + float(np.clip(gain, -max_step, max_step))) - 1.0
        return (1.0 + float(np.clip(stepped_gain, -MAX_GAIN, MAX_GAIN))) / (1.0 + self.gain) - 1.0

    def accept_gain(self, gain: float, time_s: float) -> None:
        """Add a common gain, known at `time_s`, to the present one."""
        self.gain = (1.0 + self.gain) * (1.0 + gain) - 1.0
        self.time_s = time_s

    def learn(self, reading: np.ndarray) -> None:
        """Complete the level of channels that were read less than OPENING_FRAMES times.

        `reading` (M,) is untouched, NaN where a channel was not read.
        """
        new_readings = np.isfinite(reading) & (self._count < OPENING_FRAMES)
        if new_readings.any():
            self._total[new_readings] += reading[new_readings] / (1.0 + self.gain)
            self._count[new_readings] += 1
            self._update_level()
