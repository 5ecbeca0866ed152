"""Saline tank of the LCT at 10 kHz: text files of eidors3d/eidors-readonly, ds_tank_phantom.

After the line `#Start` 209 rows of real, imaginary (V) and current (A), where the header says 208:
the last repeats its predecessor and is left out. Drive k is (k, k+1), pairs (j, j+1) with j
ascending, read as u[j+1] - u[j]. The current wanders and dividing by it makes reciprocity worse, so
it is not held.

A file is one frame, and does not say whether objects stand in the tank: it is taken for a skin as
it is, which nobody touches. A folder holds repeats of one state, named alike (`water_1.txt`,
`water_2.txt`), in the order of their `#Date`.
"""

import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from eitskin.data.importers.description import describe, swap_measured
from eitskin.data.importers.tables import first_line, numbers
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

N_ELECTRODES = 16
COLUMNS = 3
SOURCE = "eidors3d/eidors-readonly, ds_tank_phantom/{name}"


def matches(path: Path) -> bool:
    """Whether the file, or the first of a folder, begins as the LCT's do."""
    return all(first_line(file) == "#MEAS" for file in files(path)[:1]) and bool(files(path))


def load(path: Path) -> Recording:
    """One frame a file; raises InputError where a file is cut short, a folder mixes states, and one
    of several files has no date."""
    frame_files = files(path)
    if not frame_files:
        raise InputError(path, "folder", "no *.txt", "repeats of one state")
    states = sorted({re.sub(r"_\d+$", "", file.stem) for file in frame_files})
    if len(frame_files) > 1 and len(states) > 1:
        raise InputError(path, "folder", f"states {states}", "repeats of one, named NAME_<number>")
    dates, tables = zip(*map(_read, frame_files), strict=True)
    moments = _moments(frame_files, dates)
    order = np.argsort(moments, kind="stable")
    table = np.stack(tables)[order]
    metadata = describe(
        swap_measured(channel_table(N_ELECTRODES)),
        even_angles(N_ELECTRODES),
        SOURCE.format(name=path.name),
        "signed",
        unit="V",
        clock="index" if dates[0] is None else "measured",
    )
    frames = frames_table(moments[order], np.zeros(len(frame_files), dtype=bool))
    return Recording(frames, table[:, :, 0], table[:, :, 1], None, metadata)


def _moments(files: list[Path], dates: Sequence[datetime | None]) -> np.ndarray:
    """Seconds (N,) from the earliest frame; raises InputError for a frame without a date."""
    if len(files) == 1:
        return np.zeros(1)
    stated_dates = [date for date in dates if date is not None]
    if len(stated_dates) < len(dates):
        undated_file = files[dates.index(None)]
        raise InputError(undated_file, "header, #Date", "none", "dd/mm/yyyy hh:mm:ss")
    return np.array([(date - min(stated_dates)).total_seconds() for date in stated_dates])


def files(path: Path) -> list[Path]:
    """The frames, one a file."""
    return sorted(path.glob("*.txt")) if path.is_dir() else [path]


def _read(path: Path) -> tuple[datetime | None, np.ndarray]:
    """The frame's date, None where missing, and its (208, 3) table."""
    lines = path.read_text(errors="replace").splitlines()
    if "#Start" not in [line.strip() for line in lines]:
        raise InputError(path, "header", "no line #Start", "#Start before the numbers")
    start = [line.strip() for line in lines].index("#Start")
    dates = [line.replace("#Date", "").strip() for line in lines[:start] if "#Date" in line]
    try:
        date = datetime.strptime(dates[0], "%d/%m/%Y %H:%M:%S") if dates else None
    except ValueError as error:
        raise InputError(path, "header, #Date", dates[0], "dd/mm/yyyy hh:mm:ss") from error
    table = numbers(path, lines, COLUMNS, start + 1)
    n_channels = len(channel_table(N_ELECTRODES))
    if len(table) != n_channels + 1:
        raise InputError(
            path, "rows after #Start", len(table), f"{n_channels + 1}, the last unused"
        )
    return date, table[:n_channels]
