"""Ionic skin pressed by a robot: inp_*.csv, out_*.csv of DSHardman/Variable-Sensitivity-E-Skins.

CSV with a byte-order mark and no header: `inp` (P, 192) pressed minus untouched magnitudes in the
board's own unit, `out` (P, 3) x, y, z in metres in the robot's frame. Channels as in
`hydrogel_skin`. z is the robot's height, not an indentation; only the order of the presses is
known.
"""

from pathlib import Path

import numpy as np

from eitskin.data.importers import delimited
from eitskin.data.importers.description import describe, swap_measured
from eitskin.data.importers.tables import first_line, is_numbers
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

N_ELECTRODES = 16
SOURCE = "DSHardman/Variable-Sensitivity-E-Skins, {inp} and {out}"


def matches(path: Path) -> bool:
    """Whether the file is one of a pair inp_*, out_* with 192 and 3 numbers a line."""
    pair = _pair(path)
    if pair is None or not all(file.is_file() for file in pair):
        return False
    n_channels = len(channel_table(N_ELECTRODES, "opposite"))
    return is_numbers(first_line(pair[0]), n_channels) and is_numbers(first_line(pair[1]), 3)


def load(path: Path) -> Recording:
    """One touched frame a press; raises InputError where the two files do not fit together."""
    pair = _pair(path)
    if pair is None:
        raise InputError(path, "file name", path.name, "inp_<name> or out_<name>")
    for file in pair:
        if not file.is_file():
            raise InputError(file, "file", "no such file", f"the partner of {path.name}")
    channels = swap_measured(channel_table(N_ELECTRODES, "opposite"))
    tables = []
    for file, columns in zip(pair, (len(channels), 3), strict=True):
        tables.append(delimited.table(file, columns))
    difference, places = tables
    if len(difference) != len(places):
        raise InputError(pair[1], "rows", len(places), f"{len(difference)} as in {pair[0].name}")
    x, y, z = places.T * 1e3
    touch = np.ones(len(places), dtype=bool)
    frames = frames_table(np.arange(len(places)), touch, x, y)
    frames["note_robot_z_mm"] = z
    metadata = describe(
        channels,
        even_angles(N_ELECTRODES),
        SOURCE.format(inp=pair[0].name, out=pair[1].name),
        voltage="magnitude",
        position_frame="robot",
        values="difference",
    )
    return Recording(frames, difference, None, None, metadata)


def _pair(path: Path) -> tuple[Path, Path] | None:
    if path.suffix != ".csv" or path.name[:4] not in ("inp_", "out_"):
        return None
    suffix = path.name[4:]
    return path.with_name(f"inp_{suffix}"), path.with_name(f"out_{suffix}")


def files(path: Path) -> list[Path]:
    """Both of a pair."""
    return list(_pair(path) or [])
