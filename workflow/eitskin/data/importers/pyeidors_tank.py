"""Saline tank of CBZ199671/PyEIDORS: CSV without header, 208 x 4.

Columns: reference real, imaginary, target real, imaginary. Drive k is (k, k+1); its 13 pairs (j,
j+1), j = k+2 ... k+14, wrap round and are read as u[j+1] - u[j] (the sign of a homogeneous disc,
correlation -0.998 with the other). The target frame has objects in the tank, of which the folder's
name tells the electrode but nobody the place: it is no touch at a known place and no untouched
frame, so it is left out, and `source` says so. As the part `target` it is read alone, as a skin
that nobody touches, to be compared with the reference.
"""

from pathlib import Path

import numpy as np

from eitskin.data.channel_order import ORDERS
from eitskin.data.importers import delimited
from eitskin.data.importers.description import describe, swap_measured
from eitskin.data.importers.tables import first_line, is_numbers
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

N_ELECTRODES = 16
COLUMNS = 4
ORDER = "drive-plus-ascending-own"
PARTS = ("target",)
SOURCE = (
    "CBZ199671/PyEIDORS, {name} (the reference frame; the target frame, objects at unknown places, "
    "left out)"
)
TARGET = "CBZ199671/PyEIDORS, {name} (the target frame, objects at unknown places)"


def matches(path: Path) -> bool:
    """Whether the file begins with a line of four numbers."""
    return is_numbers(first_line(path), COLUMNS)


def channels_from_drive() -> np.ndarray:
    """(208, 4): each drive's pairs from its own sink onwards, wrapping round."""
    channels = channel_table(N_ELECTRODES)
    return channels[ORDERS[ORDER].permutation(channels, N_ELECTRODES)]


def load(path: Path, part: str | None = None) -> Recording:
    """The one reference frame, or the target's; raises InputError for another size or what is no
    number."""
    table = delimited.table(path, COLUMNS)
    channels = channels_from_drive()
    if len(table) != len(channels):
        raise InputError(path, "rows", len(table), f"{len(channels)}, one a channel")
    metadata = describe(
        swap_measured(channels),
        even_angles(N_ELECTRODES),
        (SOURCE if part is None else TARGET).format(name=path.name),
        "signed",
    )
    frames = frames_table(np.zeros(1), np.zeros(1, dtype=bool))
    real, imaginary = table[:, :2].T if part is None else table[:, 2:].T
    return Recording(frames, real[None], imaginary[None], None, metadata)
