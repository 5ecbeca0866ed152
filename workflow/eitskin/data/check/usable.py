"""What a diagnosis uses of a recording: readings and frames that its check does not leave out."""

import numpy as np

from eitskin.data import subset
from eitskin.data.check.copies import copies
from eitskin.data.check.loads import lost_forces
from eitskin.data.check.placeholders import measured
from eitskin.data.check.unlabelled import labelled
from eitskin.data.recording import Recording


def usable(recording: Recording) -> tuple[Recording, list[tuple[int, int]]]:
    """A recording with NaN in place of numbers that are no readings, without copies of frames and
    frames whose load cell lost its signal, and `labelled`: itself where all is well; and the
    numbers of the first and last frame of stretches in which somebody touched without a label."""
    recording = measured(recording)
    rows = np.union1d(copies(recording), lost_forces(recording))
    if 0 < len(rows) < len(recording.frames):
        is_left = ~np.isin(np.arange(len(recording.frames)), rows)
        recording = subset.of_frames(recording, is_left)
    return labelled(recording)
