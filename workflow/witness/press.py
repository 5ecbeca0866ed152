"""The force over time in each press, as defined by the recording format: linear between frames,
rising from 0 in the 0.5 s before the first, with the last slope after the last."""

from dataclasses import dataclass

import numpy as np

RISE_S = 0.5  # of the recording format


@dataclass(frozen=True)
class Press:
    """The force of one press: linear through times (K,) s and forces (K,) N, the first 0."""

    times: np.ndarray
    forces: np.ndarray

    @classmethod
    def from_reports(
        cls, times: np.ndarray, forces: np.ndarray, offset_N: float, lag_s: float
    ) -> "Press":
        """The press of reported forces that are `offset_N` too low and `lag_s` late."""
        true = np.maximum(forces + offset_N, 0.0)
        return cls(np.append(times[0] - RISE_S, times) - lag_s, np.append(0.0, true))

    def force(self, time_s: float) -> float:
        """The force, N, at a time."""
        slope = (self.forces[-1] - self.forces[-2]) / (self.times[-1] - self.times[-2])
        if time_s > self.times[-1]:
            return max(self.forces[-1] + slope * (time_s - self.times[-1]), 0.0)
        return float(np.interp(time_s, self.times, self.forces, left=0.0))

    def peak(self, time_s: float) -> float:
        """The largest force up to a time, N."""
        return max([self.force(time_s), *self.forces[self.times <= time_s]])

    def followed(self, time_s: float, tau_s: float) -> float:
        """m of tau dm/dt = F - m from m = 0: m = F - int F'(s) exp(-(t - s) / tau) ds."""
        times, forces = self.times, self.forces
        if time_s > times[-1]:
            slope = (forces[-1] - forces[-2]) / (times[-1] - times[-2])
            ends = [time_s]
            if slope < 0 and (zero := times[-1] - forces[-1] / slope) < time_s:
                ends = [zero, time_s]
            times = np.append(times, ends)
            forces = np.append(forces, [self.force(end) for end in ends])
        lagging = 0.0
        for t0, t1, f0, f1 in zip(times[:-1], times[1:], forces[:-1], forces[1:], strict=True):
            stop = min(t1, time_s)
            if stop > t0:
                slope = (f1 - f0) / (t1 - t0)
                decay_difference = np.exp(-(time_s - stop) / tau_s) - np.exp(-(time_s - t0) / tau_s)
                lagging += slope * tau_s * decay_difference
        return self.force(time_s) - lagging
