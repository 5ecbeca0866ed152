"""The frames of a long recording that are diagnosed: whole presses and untouched frames from all
of it."""

import numpy as np

from eitskin.data.recording import Recording, presses
from eitskin.data.subset import of_frames

MAX_FRAMES = 500  # more make a diagnosis longer and say little that these do not
LIMIT_GIB = 4.0  # of memory, within which as many of these are diagnosed as `memory` predicts


def excerpt(recording: Recording, max_frames: int = MAX_FRAMES) -> Recording:
    """About `max_frames` frames of a recording, at most; the recording itself if it has no more.

    Whole presses, because the force's history counts, evenly over the recording, the one with the
    largest force among them; of a press longer than a quarter of `max_frames` only some frames.
    Untouched frames evenly, in the share that they have. Times, sessions and frame numbers stay;
    `contact` numbers the presses.
    """
    selected = excerpt_mask(recording, max_frames)
    return recording if selected.all() else of_frames(recording, selected)


def excerpt_mask(recording: Recording, max_frames: int) -> np.ndarray:
    """(N,): the frames of an `excerpt`."""
    total = len(recording.frames)
    if total <= max_frames:
        return np.ones(total, bool)
    press = presses(recording)
    selected = np.zeros(total, bool)
    if (press >= 0).any():
        for label in _selected_presses(recording, press, max_frames):
            rows = np.flatnonzero(press == label)
            selected[rows[_even_indices(len(rows), max(max_frames // 4, 1))]] = True
    untouched = np.flatnonzero(press < 0)
    room = round(max_frames * len(untouched) / total)
    if room:
        selected[untouched[_even_indices(len(untouched), room)]] = True
    return selected


def _selected_presses(recording: Recording, press: np.ndarray, max_frames: int) -> np.ndarray:
    """Presses whose frames are about the share of `max_frames` that all presses have of the
    recording."""
    count = int(press.max()) + 1
    number = max(1, round(count * max_frames / len(press)))
    labels = _even_indices(count, number)
    force = recording.frames["force_N"].to_numpy(float)
    if np.isfinite(force[press >= 0]).any():
        strongest = press[np.nanargmax(np.where(press >= 0, force, np.nan))]
        labels[np.argmin(np.abs(labels - strongest))] = strongest
    return labels


def _even_indices(count: int, wanted: int) -> np.ndarray:
    """At most `wanted` indices below `count`, evenly."""
    return np.linspace(0, count - 1, min(count, wanted)).round().astype(int)
