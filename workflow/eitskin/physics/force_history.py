"""The force within each press, between and around its frames.

Linear in time between the frames of a press, rising from 0 in the RISE_S before its first,
continued with its last slope after its last (never below 0). A press of one frame has the slope of
its rise.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

RISE_S = 0.5  # assumed: recordings have no frames between two presses


@dataclass(frozen=True)
class ForceHistory:
    """Force against time in every press, and when the frames look at it.

    time_s (N,); rows: the frames of each press, in order; knots: of each press times (K,) s and
    forces (K,) N, the first 0.
    """

    time_s: np.ndarray
    rows: tuple[np.ndarray, ...]
    knots: tuple[tuple[np.ndarray, np.ndarray], ...]

    @classmethod
    def of_frames(
        cls, time_s: np.ndarray, force_N: np.ndarray, press: np.ndarray
    ) -> "ForceHistory":
        """From frames (N,) each; press -1 where untouched."""
        touched_rows = np.argsort(press, kind="stable")[(press < 0).sum() :]
        press_starts = np.flatnonzero(np.diff(press[touched_rows], prepend=-1))
        time = np.insert(
            time_s[touched_rows], press_starts, time_s[touched_rows[press_starts]] - RISE_S
        )
        force = np.insert(force_N[touched_rows], press_starts, 0.0)
        knot_starts = press_starts + np.arange(len(press_starts))
        knots = zip(_split(time, knot_starts), _split(force, knot_starts), strict=True)
        return cls(time_s, tuple(_split(touched_rows, press_starts)), tuple(knots))

    def advanced(self, lag_s: float) -> "ForceHistory":
        """The same forces, each `lag_s` earlier."""
        return replace(self, knots=tuple((time - lag_s, force) for time, force in self.knots))

    def offset(self, offset_N: float) -> "ForceHistory":
        """`offset_N` more from the first frame of each press on, never below 0."""
        knots = tuple(
            (time, np.append(0.0, np.maximum(force[1:] + offset_N, 0.0)))
            for time, force in self.knots
        )
        return replace(self, knots=knots)

    def force_N(self) -> np.ndarray:
        """(N,) N: at every frame, 0 where untouched."""
        return self._per_press(_force)

    def peak_N(self) -> np.ndarray:
        """(N,) N: the largest force of the press so far."""

        def peak(frame_time: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
            passed_peak = np.maximum.accumulate(force)[
                np.searchsorted(time, frame_time, side="right") - 1
            ]
            return np.maximum(
                np.where(frame_time < time[0], 0.0, passed_peak), _force(frame_time, time, force)
            )

        return self._per_press(peak)

    def relaxed_N(self, tau_s: float) -> np.ndarray:
        """(N,) N: m of tau dm/dt = F - m, m = 0 when the press begins, exact for linear pieces."""

        def follow(frame_time: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
            grid = np.union1d(_with_end(time, force), frame_time)
            grid_force = _force(grid, time, force)
            m = np.zeros(len(grid))
            durations = np.diff(grid)
            fades = -np.expm1(-durations / tau_s)
            slopes = np.diff(grid_force) / durations
            for k, (duration, fade, slope) in enumerate(zip(durations, fades, slopes, strict=True)):
                lagging = slope * (duration - tau_s * fade)
                m[k + 1] = m[k] + (grid_force[k] - m[k]) * fade + lagging
            return m[np.searchsorted(grid, frame_time)]

        return self._per_press(follow)

    def _per_press(
        self, value: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        values = np.zeros(len(self.time_s))
        for rows, (time, force) in zip(self.rows, self.knots, strict=True):
            values[rows] = value(self.time_s[rows], time, force)
        return values


def _split(values: np.ndarray, starts: np.ndarray) -> Iterator[np.ndarray]:
    """The parts of values (N,) that begin at `starts`, as np.split at a tenth of its time."""
    return (values[a:b] for a, b in pairwise([*starts.tolist(), len(values)]))


def _slope(time: np.ndarray, force: np.ndarray) -> float:
    return (force[-1] - force[-2]) / (time[-1] - time[-2])


def _force(frame_time: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
    overhang = np.maximum(frame_time - time[-1], 0.0)
    return np.maximum(
        np.interp(frame_time, time, force, left=0.0) + _slope(time, force) * overhang, 0.0
    )


def _with_end(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """The knots' times, and the time at which the continued force reaches 0."""
    slope = _slope(time, force)
    return np.append(time, time[-1] - force[-1] / slope) if slope < 0 else time
