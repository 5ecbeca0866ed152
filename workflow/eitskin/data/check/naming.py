"""Channels, frames and electrodes in words."""

from collections.abc import Sequence

import numpy as np

from eitskin.data.recording import Recording
from eitskin.quantities import counted, listed

MAX_NAMED = 3  # more make a sentence unreadable


def channels(recording: Recording, rows: np.ndarray | Sequence[int]) -> str:
    """`3 channels (0: drive 0-1, measured 2-3, ...)`, at most three named."""
    named_channels = ", ".join(
        "{}: drive {}-{}, measured {}-{}".format(row, *recording.channels[row])
        for row in rows[:MAX_NAMED]
    )
    ellipsis = ", ..." if len(rows) > MAX_NAMED else ""
    return f"{counted(len(rows), 'channel')} ({named_channels}{ellipsis})"


def frames(rows: np.ndarray) -> str:
    """`frame 4`, `12 frames (4 to 9, 12, ...)`, at most three runs named."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    named_runs = [
        f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs[:MAX_NAMED]
    ]
    if len(rows) == 1:
        return f"frame {rows[0]}"
    return f"{len(rows)} frames ({', '.join(named_runs)}{', ...' if len(runs) > MAX_NAMED else ''})"


def electrodes(numbers: Sequence[int]) -> str:
    """`electrode 3`, `electrodes 3 and 4`."""
    return f"electrode{'' if len(numbers) == 1 else 's'} {listed(list(numbers))}"
