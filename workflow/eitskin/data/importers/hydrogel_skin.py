"""Hydrogel skin pressed by a robot: ohmc16.mat, ohmc8.mat of DSHardman/HydrogelEIT.

`responseups` (P, M) untouched, `responsedowns` (P, M) pressed, magnitudes in the board's own unit;
`positions` (P, 3) x, y, depth in metres, the skin's centre at 0. Opposite drive, adjacent
measurement, drive-major, plus = minus + 1 ascending by minus. Electrode 0 is at the bottom, numbers
rise towards +x. Each press gives two frames, untouched then pressed; nobody measured a force and
only the order is known.
"""

from pathlib import Path

import numpy as np

from eitskin.data.importers.description import describe, swap_measured
from eitskin.data.importers.matlab_file import has_arrays, named_arrays
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

ARRAYS = ("positions", "responseups", "responsedowns")
RADIUS_MM = 85.5
SOURCE = "DSHardman/HydrogelEIT, {name}"


def matches(path: Path) -> bool:
    """Whether the file holds positions, untouched and pressed responses."""
    return has_arrays(path, ARRAYS)


def load(path: Path) -> Recording:
    """2 P frames, press by press; raises InputError where the arrays do not fit together."""
    file_arrays = named_arrays(path, ARRAYS)
    for name, array in zip(ARRAYS, file_arrays, strict=True):
        if array.dtype.kind == "c":
            raise InputError(path, name, "complex numbers", "real ones")
    positions, untouched, pressed = (array.astype(float) for array in file_arrays)
    n_presses = len(positions)
    if positions.shape != (n_presses, 3):
        raise InputError(path, "positions", positions.shape, "x, y, depth a press")
    if untouched.shape != pressed.shape or len(untouched) != n_presses:
        shapes = f"{untouched.shape} untouched, {pressed.shape} pressed"
        raise InputError(path, "responses", shapes, f"two alike with {n_presses} rows")
    n_channels = untouched.shape[1]
    n = 2 + round((4 + n_channels) ** 0.5)
    if not n_channels or n % 2 or n * (n - 4) != n_channels:
        expected = "n (n - 4): opposite drive, adjacent measurement"
        raise InputError(path, "responses", f"{n_channels} channels", expected)
    x, y, depth = np.repeat(positions * 1e3, 2, axis=0).T
    touch = np.tile([False, True], n_presses)
    frames = frames_table(np.arange(2 * n_presses), touch, x, y, depth_mm=depth)
    frames["contact"] = (frames["frame"] // 2).where(touch).astype("Int64")
    metadata = describe(
        swap_measured(channel_table(n, "opposite")),
        even_angles(n, -90.0),
        SOURCE.format(name=path.name),
        voltage="magnitude",
        skin={"radius_mm": RADIUS_MM},
    )
    voltage = np.stack([untouched, pressed], axis=1).reshape(2 * n_presses, n_channels)
    return Recording(frames, voltage, None, None, metadata)
