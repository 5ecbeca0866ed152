"""The untouched frame, followed as it drifts while nobody touches."""

import numpy as np

OPENING = 10  # frames at the start, the skin untouched
MEMORY = 20  # untouched frames over which the level is averaged


class Untouched:
    """The level (M,) of readings that nobody touches: the mean of the opening frames (n, M), then
    an exponential mean over MEMORY frames. NaN where a channel has never been read."""

    def __init__(self, opening: np.ndarray):
        there = np.isfinite(opening)
        self._count = there.sum(axis=0).astype(float)
        total = np.where(there, opening, 0.0).sum(axis=0)
        with np.errstate(invalid="ignore"):
            self.level = total / np.where(there.any(axis=0), self._count, np.nan)

    def follow(self, reading: np.ndarray) -> None:
        """Take in an untouched reading (M,), NaN where a channel is to be left as it was."""
        there = np.isfinite(reading)
        self._count[there] = np.minimum(self._count[there] + 1.0, MEMORY)
        step = (reading - self.level) / self._count
        first = there & ~np.isfinite(self.level)
        self.level[there] += step[there]
        self.level[first] = reading[first]

    def without_gain(self, change: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, float]:
        """A change (M,) without what a common gain of all readings makes of the level, as the
        conductivity's drift does, and that gain less 1; by least squares in units of `scale`."""
        there = np.isfinite(change) & np.isfinite(self.level)
        level, moved = self.level[there] / scale[there], change[there] / scale[there]
        gain = float(level @ moved / (level @ level))
        return change - gain * self.level, gain
