"""How much memory a diagnosis takes, predicted from counts before it begins.

What grows with the recording are columns of readings (frames x channels): derivatives by every
candidate, errors of the rig, trials that were fitted. Where somebody touches, a gain for every
channel is tried: as many columns as channels. Where errors of frames spread a channel's errors to
others, matrices of channels x channels come with every set of effects. What does not grow with the
recording are the matrices of electrodes, of sheets and of bodies, and the simulated states in the
cache. How many of each there are was measured (`tests/unit/diagnose/fitting/test_memory.py`) in
long searches; most searches take less.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB, MAX_FRAMES
from eitskin.diagnose.fitting.families import MOST_DERIVATIVES, MOST_TOUCHED_DERIVATIVES
from eitskin.diagnose.fitting.jacobian import GROUP_BYTES, WHOLE_BYTES
from eitskin.diagnose.fitting.simulator import CACHED_BYTES, CACHED_FRAMES, beliefs
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.physics import touch_cache
from eitskin.physics.accuracy import MODES
from eitskin.physics.depth import DEPTH_ACCURACIES
from eitskin.physics.forward import ACCURACIES
from eitskin.physics.geometry import Geometry
from eitskin.physics.solver import skin_capacity

MIN_FRAMES = 20  # an excerpt of fewer shows too little for a diagnosis
GIB, FLOAT_BYTES = 1 << 30, 8  # bytes of a GiB and of a number in double precision
PROGRAM_BYTES = 320 << 20  # interpreter and libraries, and what the allocator holds back
# Measured: how many of each there are at once. An electrode has two nodes a mode of a sheet.
SHEET_MATRICES = 5  # of the matrix of the finest sheet's nodes
CACHED_BODY_MATRICES, SOLVER_MATRICES = 2, 3  # of the matrices of a body's modes
TRIAL_COLUMNS = 600  # of columns of trials, sets and rig errors
# Families of as many members as electrodes, the members of the rim's, and how many copies of their
# columns there are: as derivatives, filtered, in single precision, weighted, as directions.
FAMILIES, RIM_COLUMNS, FAMILY_COPIES = 7, 8, 6
GAIN_COLUMNS = 5  # of the columns of a gain for every channel
GROUP_COPIES = 6  # of columns that are mapped at once
LINKED_MATRICES, LASTING_ERRORS = 14, 2  # of the matrix of channels by errors that last
TOUCH_CACHES = 2  # of stores of touched places: of the nominal skin, and of one that is tried


@dataclass(frozen=True)
class Counts:
    """What determines the memory of a recording's diagnosis. touched: whether anybody touches;
    body_bytes: of the matrices of the largest body that is fitted, 0 where none is."""

    electrodes: int
    channels: int
    touched: bool
    body_bytes: int

    @classmethod
    def from_recording(cls, recording: Recording) -> "Counts":
        """The counts of a recording."""
        touched = bool(recording.frames["touch"].any())
        body_bytes = _body_bytes(recording, touched)
        return cls(recording.n_electrodes, len(recording.channels), touched, body_bytes)


def _body_bytes(recording: Recording, touched: bool) -> int:
    """Bytes of the matrices of the largest body that fits try for a skin; 0 where they try none, or
    its electrodes are points, which are on no body."""
    geometry = Geometry.from_skin(beliefs(recording)[0])
    if geometry.points:
        return 0
    effects = [effect for effect in EFFECTS.values() if effect.is_stated(recording.skin, touched)]
    bodies = [body for effect in effects if (body := effect.largest_body(geometry)) is not None]
    across, up = ACCURACIES["diagnose"], DEPTH_ACCURACIES["diagnose"]
    return max((up.most_bytes(body, across) for body in bodies), default=0)


def peak_bytes(counts: Counts, frames: int | np.ndarray) -> np.ndarray:
    """Bytes that a diagnosis of so many frames takes at most; frames: a number, or an array of
    numbers."""
    n, m = counts.electrodes, counts.channels
    column = FLOAT_BYTES * m * np.asarray(frames, dtype=float)
    pairs = n * (n - 1) / 2
    # In double precision for draws of chance, and in single precision.
    derivatives = (pairs + 11 * n + 70) + (pairs + 6 * n + 45)
    members = (FAMILIES * n + RIM_COLUMNS) * column / FLOAT_BYTES
    most = MOST_TOUCHED_DERIVATIVES if counts.touched else MOST_DERIVATIVES
    families = FAMILY_COPIES * FLOAT_BYTES * np.minimum(members, most)
    gains = m * column * counts.touched
    mapped = np.where(gains > WHOLE_BYTES, GROUP_BYTES, gains)
    linked_matrix = FLOAT_BYTES * (m * (LASTING_ERRORS if counts.touched else 1)) ** 2
    states = min(CACHED_BYTES, CACHED_FRAMES * FLOAT_BYTES * (n**2 + 3 * m))
    searched = (
        (derivatives + TRIAL_COLUMNS) * column
        + families
        + GAIN_COLUMNS * gains
        + GROUP_COPIES * mapped
        + LINKED_MATRICES * linked_matrix
    )
    sheets = SHEET_MATRICES * FLOAT_BYTES * (2 * MODES[-1] * n) ** 2
    places = TOUCH_CACHES * touch_cache.CACHE_BYTES * counts.touched
    matrices = counts.body_bytes
    bodies = (
        SOLVER_MATRICES + CACHED_BODY_MATRICES * skin_capacity(CACHED_BODY_MATRICES * matrices)
    ) * matrices + (sheets if matrices else 0)
    return PROGRAM_BYTES + places + np.maximum(searched + max(states, bodies), sheets)


def frame_limit(
    recording: Recording, limit_GiB: float = LIMIT_GIB, file: str | Path = "recording"
) -> int:
    """The number of frames of a recording, at most MAX_FRAMES, that a diagnosis takes within a
    limit. Raises InputError, with `file` as its place, where it is below MIN_FRAMES and below the
    recording's number."""
    counts, held = Counts.from_recording(recording), _held_bytes(recording)
    limit = limit_GiB * GIB - held
    frames = np.arange(1, MAX_FRAMES + 1)
    within = frames[peak_bytes(counts, frames) <= limit]
    min_frames = min(len(recording.frames), MIN_FRAMES)
    if len(within) and within[-1] >= min_frames:
        return int(within[-1])
    n, m = counts.electrodes, counts.channels
    if peak_bytes(counts, min_frames) <= limit_GiB * GIB:
        actual = f"{len(recording.frames)} frames, which take {held / GIB:.1f} GiB before any fit"
        expected = f"at most {limit_GiB:g} GiB: a part, --frames FIRST:LAST, or --memory GIB"
        raise InputError(file, "memory", actual, expected)
    actual = (
        f"{m} channels of {n} electrodes, of which {min_frames} frames take up to "
        f"{float(peak_bytes(counts, min_frames)) / GIB:.1f} GiB"
    )
    raise InputError(
        file, "memory", actual, f"at most {limit_GiB:g} GiB: {_way_out(counts, min_frames, limit)}"
    )


def _held_bytes(recording: Recording) -> int:
    """Bytes of readings beyond those of MAX_FRAMES frames, held while these are fitted."""
    columns = (recording.voltage, recording.quadrature)
    return sum(values[MAX_FRAMES:].nbytes for values in columns if values is not None)


def _way_out(counts: Counts, frames: int, limit: float) -> str:
    """Advice where so many frames take more than a limit, in bytes."""
    channels = np.arange(1, counts.channels)
    fewer = [m for m in channels if peak_bytes(replace(counts, channels=int(m)), frames) <= limit]
    if not fewer:
        return "fewer electrodes, or more memory by --memory GIB"
    return f"a recording of {fewer[-1]} channels or fewer, or more memory by --memory GIB"
