"""Saline tank of the IIRC, 16 electrodes: iirc_data_2006.mat of eidors3d/eidors-readonly.

`v_reference` (256, 1) the empty tank, `v_rotate` (256, F) with a rod carried round, complex;
reshaped (16, 16): row = drive (k, k+1), column = measurement (j, j+1). Each pair is read at u[j] -
u[j+1] with current entering at k: so the sign agrees with a homogeneous disc's (correlation 0.998).

The rod's places were not written down, so its frames cannot be touches; and they are not untouched
either. They are left out, as are the 48 readings that share an electrode with their drive (the
drive pair itself reads far less than its neighbour there): `source` says so. As the part
`v_rotate:K` the rod's frame K is read alone, as a skin that nobody touches.
"""

from pathlib import Path

import numpy as np

from eitskin.data.importers.description import describe
from eitskin.data.importers.matlab_file import has_arrays, named_arrays
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

ARRAYS = ("v_reference", "v_rotate")
PARTS = ARRAYS[1:]
N_ELECTRODES = 16
SOURCE = (
    "eidors3d/eidors-readonly, {name} (the empty tank; {left_out} frames with a rod at unknown "
    "places and 48 readings at driven electrodes left out)"
)
ROD = "eidors3d/eidors-readonly, {name} (frame {frame} with a rod at an unknown place)"
# Tank 20 cm across, water 6 cm deep, round electrodes of 1 cm: the file's own description.
SKIN = {
    "radius_mm": 100.0,
    "thickness_mm": 60.0,
    "electrode_width_mm": 10.0,
    "electrode_height_mm": 10.0,
}


def matches(path: Path) -> bool:
    """Whether the file holds the reference and the rotated frames."""
    return has_arrays(path, ARRAYS)


def load(path: Path, part: str | None = None) -> Recording:
    """The one frame of the empty tank, or one with the rod; raises InputError for another size, and
    for a frame that is not there."""
    reference, rod_frames = named_arrays(path, ARRAYS)
    if reference.shape != (N_ELECTRODES**2, 1):
        raise InputError(path, "v_reference", reference.shape, "(256, 1)")
    channels = channel_table(N_ELECTRODES)
    reading = readings(reference)
    source = SOURCE.format(name=path.name, left_out=rod_frames.shape[1])
    if part is not None:
        frame = part.partition(":")[2]
        if not frame.isdigit() or int(frame) >= rod_frames.shape[1]:
            expected = f"{ARRAYS[1]}:0 to {ARRAYS[1]}:{rod_frames.shape[1] - 1}"
            raise InputError(path, "part", repr(part), expected)
        reading = readings(rod_frames[:, [int(frame)]])
        source = ROD.format(name=path.name, frame=int(frame))
    metadata = describe(channels, even_angles(N_ELECTRODES), source, "signed", skin=SKIN)
    frames = frames_table(np.zeros(1), np.zeros(1, dtype=bool))
    return Recording(frames, reading.real, reading.imag, None, metadata)


def readings(frames: np.ndarray) -> np.ndarray:
    """(F, 208) complex, in the order of `channel_table`, of frames (256, F) as the file has them:
    those that share no electrode with their drive."""
    channels = channel_table(N_ELECTRODES)
    return frames[N_ELECTRODES * channels[:, 0] + channels[:, 2]].T.astype(complex)
