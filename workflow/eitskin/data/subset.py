"""Subsets of a recording's frames, as recordings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, presses, validate
from eitskin.errors import InputError


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
