"""What readings are where nobody touches: the opening frames' and a common gain.

Nothing else of a level is followed. A gain of all readings is what the conductivity's drift does
and no touch; whatever else moves slowly may be a slow press, and is compared with the opening
frames like a quick one.
"""

import numpy as np

from eitskin.exported.channels import Channels

OPENING = 10  # frames at the start, the skin untouched
PER_S = 0.02 / 60.0  # 1/s, of a gain: water's conductivity rises by 2 % a K, a skin by 1 K a minute
LARGEST = 0.1  # of a gain since the opening frames: by 5 K; then what was trained is another skin


class Untouched:
    """The level (M,) of readings that nobody touches: the mean of the opening frames (n, M), NaN
    where a channel was not read; `gain`: by how much of it all readings have moved since, which was
    last known at `time_s`."""

    def __init__(self, opening: np.ndarray, time_s: float, channels: Channels, scale: np.ndarray):
        there = np.isfinite(opening)
        self._count = there.sum(axis=0)
        self._total = np.where(there, opening, 0.0).sum(axis=0)
        self._channels, self._scale = channels, scale
        self._weights: dict[tuple, np.ndarray] = {}
        self.gain, self.time_s = 0.0, time_s
        self._mean()

    def _mean(self) -> None:
        counted = np.where(self._count > 0, self._count, np.nan)
        self.level = self._total / counted
        self._weights.clear()

    def change(self, reading: np.ndarray) -> np.ndarray:
        """Of a reading (M,), without the gain as it was last known: it is of a touch's part too."""
        return reading / (1.0 + self.gain) - self.level

    def moved(self, change: np.ndarray) -> float:
        """The common gain in a change (M,), beside what touches do: by least squares over what the
        touches of its strength leave unexplained (Aitken 1935)."""
        z = change / self._scale
        gone = tuple(np.flatnonzero(np.isnan(z)).tolist())
        key = self._channels.strength_class(z), gone
        if key not in self._weights:
            self._weights[key] = self._channels.pattern_weights(self.level / self._scale, *key)
        return float(np.nan_to_num(z) @ self._weights[key])

    def allowed(self, moved: float, time_s: float) -> float:
        """What of a gain that has moved a skin's drift can be, since it was last known."""
        most = PER_S * max(time_s - self.time_s, 0.0)
        within = (1.0 + self.gain) * (1.0 + float(np.clip(moved, -most, most))) - 1.0
        return (1.0 + float(np.clip(within, -LARGEST, LARGEST))) / (1.0 + self.gain) - 1.0

    def known(self, moved: float, time_s: float) -> None:
        """The gain has moved by so much."""
        self.gain = (1.0 + self.gain) * (1.0 + moved) - 1.0
        self.time_s = time_s

    def learn(self, reading: np.ndarray) -> None:
        """Take in of an untouched reading (M,) the channels that were not read OPENING times, as
        they were when the stream began; NaN: not read."""
        fresh = np.isfinite(reading) & (self._count < OPENING)
        if fresh.any():
            self._total[fresh] += reading[fresh] / (1.0 + self.gain)
            self._count[fresh] += 1
            self._mean()
