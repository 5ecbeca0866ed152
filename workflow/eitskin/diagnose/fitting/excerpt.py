"""What of a long recording is diagnosed: whole presses and untouched frames from all of it."""

import numpy as np

from eitskin.data.recording import Recording, presses
from eitskin.data.subset import of_frames

MOST_FRAMES = 500
LIMIT_GIB = 4.0  # of memory, within which as many of these are diagnosed as `memory` foretells


def excerpt(recorded: Recording, most: int = MOST_FRAMES) -> Recording:
    """At most about `most` frames of a recording, itself if it has no more.

    Whole presses, because the force's history counts, evenly over the recording, the one with the
    largest force among them; only of a press longer than a quarter of `most` some frames.
    Untouched frames evenly, in the share that they have. Times, sessions and frame numbers stay;
    `contact` tells the presses apart.
    """
    total = len(recorded.frames)
    if total <= most:
        return recorded
    press = presses(recorded)
    kept = np.zeros(total, bool)
    if (press >= 0).any():
        for label in _chosen(recorded, press, most):
            rows = np.flatnonzero(press == label)
            kept[rows[_evenly(len(rows), max(most // 4, 1))]] = True
    untouched = np.flatnonzero(press < 0)
    room = round(most * len(untouched) / total)
    if room:
        kept[untouched[_evenly(len(untouched), room)]] = True
    return of_frames(recorded, kept)


def _chosen(recorded: Recording, press: np.ndarray, most: int) -> np.ndarray:
    """Presses whose frames are about the share of `most` that all presses have of the recording."""
    count = int(press.max()) + 1
    number = max(1, round(count * most / len(press)))
    chosen = _evenly(count, number)
    force = recorded.frames["force_N"].to_numpy(float)
    if np.isfinite(force[press >= 0]).any():
        strongest = press[np.nanargmax(np.where(press >= 0, force, np.nan))]
        chosen[np.argmin(np.abs(chosen - strongest))] = strongest
    return chosen


def _evenly(count: int, wanted: int) -> np.ndarray:
    """At most `wanted` indices below `count`, evenly."""
    return np.linspace(0, count - 1, min(count, wanted)).round().astype(int)
