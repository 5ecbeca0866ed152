"""The force in each press as the recording format reads it: linear between frames, rising from 0
in the 0.5 s before the first, going on at its last slope after the last."""

from dataclasses import dataclass

import numpy as np

RISE_S = 0.5


@dataclass(frozen=True)
class Press:
    """Force of one press: linear through times (K,) s and forces (K,) N, the first 0, and on."""

    times: np.ndarray
    forces: np.ndarray

    @classmethod
    def of(cls, times: np.ndarray, forces: np.ndarray, offset_N: float, lag_s: float) -> "Press":
        """The true force of frames' reported ones: `offset_N` more, reported `lag_s` late."""
        true = np.maximum(forces + offset_N, 0.0)
        return cls(np.append(times[0] - RISE_S, times) - lag_s, np.append(0.0, true))

    def force(self, at: float) -> float:
        """N at a time."""
        slope = (self.forces[-1] - self.forces[-2]) / (self.times[-1] - self.times[-2])
        if at > self.times[-1]:
            return max(self.forces[-1] + slope * (at - self.times[-1]), 0.0)
        return float(np.interp(at, self.times, self.forces, left=0.0))

    def peak(self, at: float) -> float:
        """The largest force up to a time, N."""
        return max([self.force(at), *self.forces[self.times <= at]])

    def followed(self, at: float, tau_s: float) -> float:
        """m of tau dm/dt = F - m from m = 0: F less what each piece's rise has not yet caught up
        with, int F'(s) exp(-(t - s) / tau) ds."""
        times, forces = self.times, self.forces
        if at > times[-1]:
            slope = (forces[-1] - forces[-2]) / (times[-1] - times[-2])
            ends = [at]
            if slope < 0 and (zero := times[-1] - forces[-1] / slope) < at:
                ends = [zero, at]
            times = np.append(times, ends)
            forces = np.append(forces, [self.force(end) for end in ends])
        lagging = 0.0
        for t0, t1, f0, f1 in zip(times[:-1], times[1:], forces[:-1], forces[1:], strict=True):
            stop = min(t1, at)
            if stop > t0:
                slope = (f1 - f0) / (t1 - t0)
                late = np.exp(-(at - stop) / tau_s) - np.exp(-(at - t0) / tau_s)
                lagging += slope * tau_s * late
        return self.force(at) - lagging
