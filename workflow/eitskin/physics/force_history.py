"""The force within each press, between and around its frames.

Linear in time between the frames of a press, rising from 0 in the 0.5 s before its first, going on
at its last slope after its last (never below 0). A press of one frame has the slope of its rise.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

RISE_S = 0.5


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
        own = np.argsort(press, kind="stable")[(press < 0).sum() :]
        first = np.flatnonzero(np.diff(press[own], prepend=-1))
        time = np.insert(time_s[own], first, time_s[own[first]] - RISE_S)
        force = np.insert(force_N[own], first, 0.0)
        begin = first + np.arange(len(first))
        knots = zip(_split(time, begin), _split(force, begin), strict=True)
        return cls(time_s, tuple(_split(own, first)), tuple(knots))

    def earlier(self, lag_s: float) -> "ForceHistory":
        """The same forces, each `lag_s` earlier."""
        return replace(self, knots=tuple((time - lag_s, force) for time, force in self.knots))

    def raised(self, offset_N: float) -> "ForceHistory":
        """`offset_N` more from the first frame of each press on, never below 0."""
        knots = tuple(
            (time, np.append(0.0, np.maximum(force[1:] + offset_N, 0.0)))
            for time, force in self.knots
        )
        return replace(self, knots=knots)

    def force_N(self) -> np.ndarray:
        """(N,) N: at every frame, 0 where untouched."""
        return self._of_presses(_force)

    def peak_N(self) -> np.ndarray:
        """(N,) N: the largest force of the press so far."""

        def peak(at: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
            before = np.maximum.accumulate(force)[np.searchsorted(time, at, side="right") - 1]
            return np.maximum(np.where(at < time[0], 0.0, before), _force(at, time, force))

        return self._of_presses(peak)

    def followed_N(self, tau_s: float) -> np.ndarray:
        """(N,) N: m of tau dm/dt = F - m, m = 0 when the press begins, exact for linear pieces."""

        def follow(at: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
            grid = np.union1d(_with_end(time, force), at)
            there = _force(grid, time, force)
            m = np.zeros(len(grid))
            lasts = np.diff(grid)
            fades = -np.expm1(-lasts / tau_s)
            slopes = np.diff(there) / lasts
            for k, (last, fade, slope) in enumerate(zip(lasts, fades, slopes, strict=True)):
                lagging = slope * (last - tau_s * fade)
                m[k + 1] = m[k] + (there[k] - m[k]) * fade + lagging
            return m[np.searchsorted(grid, at)]

        return self._of_presses(follow)

    def _of_presses(
        self, value: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        result = np.zeros(len(self.time_s))
        for rows, (time, force) in zip(self.rows, self.knots, strict=True):
            result[rows] = value(self.time_s[rows], time, force)
        return result


def _split(values: np.ndarray, begin: np.ndarray) -> Iterator[np.ndarray]:
    """The parts of (N,) that begin there, as np.split at a tenth of its time."""
    return (values[a:b] for a, b in pairwise([*begin.tolist(), len(values)]))


def _slope(time: np.ndarray, force: np.ndarray) -> float:
    return (force[-1] - force[-2]) / (time[-1] - time[-2])


def _force(at: np.ndarray, time: np.ndarray, force: np.ndarray) -> np.ndarray:
    after = np.maximum(at - time[-1], 0.0)
    return np.maximum(np.interp(at, time, force, left=0.0) + _slope(time, force) * after, 0.0)


def _with_end(time: np.ndarray, force: np.ndarray) -> np.ndarray:
    """The knots' times, with the moment at which the going-on force reaches 0."""
    slope = _slope(time, force)
    return np.append(time, time[-1] - force[-1] / slope) if slope < 0 else time
