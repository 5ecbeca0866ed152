"""Subsets of a recording's frames, as recordings."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, presses, validate
from eitskin.errors import InputError

BLOCK_BYTES = 16 << 20  # of readings: what is computed of them takes twenty times as much
STRETCHES = 32  # of a sample
OVERLAP = 8  # part of a block that the next one has again


def of_frames(recorded: Recording, is_selected: np.ndarray) -> Recording:
    """The selected frames (N,) bool of a recording, with their times, sessions and presses."""
    press = presses(recorded)
    frames = recorded.frames[is_selected].reset_index(drop=True)
    label = pd.Series(press[is_selected], dtype="Int64")
    frames["contact"] = label.where(label >= 0)
    rows = np.flatnonzero(is_selected)
    return Recording(
        frames,
        None if recorded.voltage is None else recorded.voltage[is_selected],
        None if recorded.quadrature is None else recorded.quadrature[is_selected],
        None if recorded.touches is None else [recorded.touches[row] for row in rows],
        recorded.metadata,
    )


def stretch(recorded: Recording, first_frame: int, last_frame: int, file: str | Path) -> Recording:
    """Frames `first_frame` to `last_frame` as a recording, numbered from 0, at their old times.

    Its `source` states the range. Raises InputError naming `file` where there are no such frames,
    and where they break a rule of the format, as absolute values without an untouched frame do.
    """
    count = len(recorded.frames)
    if not 0 <= first_frame <= last_frame < count:
        expected = f"FIRST:LAST, of frames 0 to {count - 1}"
        raise InputError(file, "frames", f"{first_frame}:{last_frame}", expected)
    rows = np.arange(count)
    selection = of_frames(recorded, (rows >= first_frame) & (rows <= last_frame))
    source = f"{recorded.metadata['source']}; its frames {first_frame} to {last_frame}"
    selection = replace(numbered(selection), metadata=recorded.metadata | {"source": source})
    validate(selection, file)
    return selection


def numbered(recorded: Recording) -> Recording:
    """A recording with its frames numbered from 0."""
    frames = recorded.frames.assign(frame=np.arange(len(recorded.frames)))
    return replace(recorded, frames=frames)


def blocks(recorded: Recording) -> Iterator[tuple[int, range, Recording]]:
    """Parts of a recording of about BLOCK_BYTES of readings, in order, each with some frames of its
    neighbours; of a short one itself.

    With each part the row of its first frame, and the rows of the recording that it alone answers
    for.
    """
    count, size = len(recorded.frames), _block_frames(recorded)
    if count <= size:
        yield 0, range(count), recorded
        return
    margin = size // OVERLAP // 2
    for start in range(0, count - 2 * margin, size - 2 * margin):
        end = min(start + size, count)
        is_last = end == count
        answered = range(start + margin * (start > 0), end - margin * (not is_last))
        yield start, answered, _rows(recorded, slice(start, end))


def sample(recorded: Recording) -> Recording:
    """About BLOCK_BYTES of readings of a recording: STRETCHES stretches of its frames, evenly from
    first to last, and the first untouched frame of every session; a short one itself."""
    count, size = len(recorded.frames), _block_frames(recorded)
    if count <= size:
        return recorded
    length = size // STRETCHES
    starts = np.linspace(0, count - length, STRETCHES).astype(int)
    is_selected = np.zeros(count, bool)
    is_selected[starts[:, None] + np.arange(length)] = True
    untouched = recorded.frames[~recorded.frames["touch"].to_numpy(bool)]
    sessions = untouched["session"] if "session" in untouched else pd.Series(0, untouched.index)
    is_selected[sessions.index[~sessions.duplicated()]] = True
    return of_frames(recorded, is_selected)


def _block_frames(recorded: Recording) -> int:
    """Frames of a block: of many channels still enough for levels and noise."""
    return max(BLOCK_BYTES // (8 * len(recorded.metadata["channels"])), 20 * STRETCHES)


def _rows(recorded: Recording, rows: slice) -> Recording:
    """Successive frames of a recording, whose readings it shares."""
    return Recording(
        recorded.frames[rows].reset_index(drop=True),
        None if recorded.voltage is None else recorded.voltage[rows],
        None if recorded.quadrature is None else recorded.quadrature[rows],
        None if recorded.touches is None else recorded.touches[rows],
        recorded.metadata,
    )
