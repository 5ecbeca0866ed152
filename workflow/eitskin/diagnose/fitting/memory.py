"""How much memory a diagnosis takes, foretold from counts before any of it is done.

What grows with the recording are columns of readings (frames x channels): derivatives by every
candidate, what rigs add, trials that were fitted. Where somebody touches, a gain of its own for
every channel is tried: as many columns as channels. Where errors of frames carry a channel's errors
to others, matrices of channels x channels come with every set that is looked at. What does not grow
with it are the matrices of electrodes, of sheets and of bodies, and the states kept that were
simulated last. How many of each there are was measured (`tests/unit/diagnose/fitting/test_memory.py`); a
long search takes so many, most take less.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB, MOST_FRAMES
from eitskin.diagnose.fitting.jacobian import AT_ONCE, GROUP
from eitskin.diagnose.fitting.simulator import KEPT, KEPT_BYTES, beliefs
from eitskin.effects.third_dimension import HEIGHTS
from eitskin.errors import InputError
from eitskin.physics import touch_cache
from eitskin.physics.accuracy import MODES
from eitskin.physics.depth import DEPTH_ACCURACIES, MOST_MODES, span
from eitskin.physics.forward import ACCURACIES
from eitskin.physics.geometry import Geometry
from eitskin.physics.solver import skin_capacity

LEAST_FRAMES = 20  # an excerpt of fewer is not worth a diagnosis
GIB, NUMBER = 1 << 30, 8  # bytes
PROGRAM = 320 << 20  # interpreter and libraries, and what the allocator holds back
# How many there are at once ...
SHEET = 5  # of the matrix of the finest sheet's nodes, of which an electrode has two a mode
KEPT_BODY, SOLVED_BODY = 2, 3  # of the matrix of a body's modes
TRIED = 600  # of columns of trials, sets and rig errors
GAINS = 5  # of the columns of a gain for every channel
MAPPED = 6  # of columns that are mapped at once
LINKED, LASTING = 14, 2  # of the matrix of channels by errors that last
OUTLINES = 2  # of stores of touched places: of the skin believed, and of one that is tried


@dataclass(frozen=True)
class Counts:
    """What a recording's diagnosis is foretold from. touched: whether anybody touches; modes: of
    the electrodes of the largest body that is fitted, 0 where none is."""

    electrodes: int
    channels: int
    touched: bool
    modes: int

    @classmethod
    def of(cls, recorded: Recording) -> "Counts":
        """Of a recording."""
        touched = bool(recorded.frames["touch"].any())
        body = not touched or recorded.skin.electrode_height_mm is not None
        modes = _modes(recorded) if body else 0
        return cls(recorded.n_electrodes, len(recorded.channels), touched, modes)


def _modes(recorded: Recording) -> int:
    """Modes of all electrodes together of a skin as a body, as high ones as are tried where nobody
    knows their height; 0 of points, which are on no body."""
    geometry = Geometry.from_skin(beliefs(recorded)[0])
    if geometry.points:
        return 0
    height = geometry.electrode_height_mm or HEIGHTS[-1] * geometry.thickness_mm
    body = geometry.with_values(deep=True, electrode_height_mm=height)
    across = ACCURACIES["diagnose"].modes(body)
    heights = span(body)
    assert heights is not None
    up = DEPTH_ACCURACIES["diagnose"].modes(body, heights, across)
    return min(recorded.n_electrodes * across * up, MOST_MODES)


def foretold(counts: Counts, frames: int | np.ndarray) -> np.ndarray:
    """Bytes that a diagnosis takes at most, of one number of frames or of several."""
    n, m = counts.electrodes, counts.channels
    column = NUMBER * m * np.asarray(frames, dtype=float)
    pairs = n * (n - 1) / 2
    # In double precision for draws of chance, and in single precision.
    derivatives = (pairs + 11 * n + 70) + (pairs + 6 * n + 45)
    gains = m * column * counts.touched
    mapped = np.where(gains > AT_ONCE, GROUP, gains)
    linked = NUMBER * (m * (LASTING if counts.touched else 1)) ** 2
    states = min(KEPT_BYTES, KEPT * NUMBER * (n**2 + 3 * m))
    searched = (derivatives + TRIED) * column + GAINS * gains + MAPPED * mapped + LINKED * linked
    sheets = SHEET * NUMBER * (2 * MODES[-1] * n) ** 2
    places = OUTLINES * touch_cache.CACHE_BYTES * counts.touched
    matrix = NUMBER * counts.modes**2
    bodies = (SOLVED_BODY + KEPT_BODY * skin_capacity(KEPT_BODY * matrix)) * matrix + (
        sheets if counts.modes else 0
    )
    return PROGRAM + places + np.maximum(searched + max(states, bodies), sheets)


def most_frames(
    recorded: Recording, limit_GiB: float = LIMIT_GIB, file: str | Path = "recording"
) -> int:
    """How many frames of a recording, at most MOST_FRAMES, are diagnosed within a limit. Raises
    InputError, with `file` as its place, where they are fewer than LEAST_FRAMES and than it has."""
    counts, limit = Counts.of(recorded), limit_GiB * GIB
    frames = np.arange(1, MOST_FRAMES + 1)
    within = frames[foretold(counts, frames) <= limit]
    least = min(len(recorded.frames), LEAST_FRAMES)
    if len(within) and within[-1] >= least:
        return int(within[-1])
    n, m = counts.electrodes, counts.channels
    found = (
        f"{m} channels of {n} electrodes, of which {least} frames take up to "
        f"{float(foretold(counts, least)) / GIB:.1f} GiB"
    )
    raise InputError(
        file, "memory", found, f"at most {limit_GiB:g} GiB: {_way_out(counts, least, limit)}"
    )


def _way_out(counts: Counts, frames: int, limit: float) -> str:
    """What to do where so many frames take more than a limit."""
    channels = np.arange(1, counts.channels)
    fewer = [m for m in channels if foretold(replace(counts, channels=int(m)), frames) <= limit]
    if not fewer:
        return "fewer electrodes, or more memory by --memory GIB"
    return f"a recording of {fewer[-1]} channels or fewer, or more memory by --memory GIB"
