"""Some of a recording's frames, as a recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording, presses, validate
from eitskin.errors import InputError


def of_frames(recorded: Recording, kept: np.ndarray) -> Recording:
    """The frames of a recording that are kept (N,), with their times, sessions and numbers."""
    press = presses(recorded)
    frames = recorded.frames[kept].reset_index(drop=True)
    label = pd.Series(press[kept], dtype="Int64")
    frames["contact"] = label.where(label >= 0)
    rows = np.flatnonzero(kept)
    return Recording(
        frames,
        None if recorded.voltage is None else recorded.voltage[kept],
        None if recorded.quadrature is None else recorded.quadrature[kept],
        None if recorded.touches is None else [recorded.touches[row] for row in rows],
        recorded.metadata,
    )


def stretch(recorded: Recording, first: int, last: int, file: str | Path) -> Recording:
    """Frames `first` to `last` of a recording as one of their own, which `source` says: numbered
    from 0, at the times that they had.

    Raises InputError, with `file` as its place, where there are no such frames, or where they break
    a rule of the format: no untouched one among absolute values.
    """
    count = len(recorded.frames)
    if not 0 <= first <= last < count:
        expected = f"FIRST:LAST, of frames 0 to {count - 1}"
        raise InputError(file, "frames", f"{first}:{last}", expected)
    rows = np.arange(count)
    part = of_frames(recorded, (rows >= first) & (rows <= last))
    frames = part.frames.assign(frame=np.arange(len(part.frames)))
    source = f"{recorded.metadata['source']}; its frames {first} to {last}"
    part = replace(part, frames=frames, metadata=recorded.metadata | {"source": source})
    validate(part, file)
    return part
