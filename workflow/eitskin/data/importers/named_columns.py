"""What the names of a table's columns tell: parts of complex readings, channels, a row a reading.

`E01_E09_E02_E10_Magnitude` and `..._Phase` are one complex reading of the channel [0, 8, 1, 9],
source and sink first; columns `a`, `b`, `m`, `n` beside a reading are the electrodes of the reading
in that row (BERT, ResIPy). Electrodes count from 0 where one is 0, else from 1.
"""

import re
from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.skin import MAX_ELECTRODES

PARTS = {
    "magnitude": r"magnitude|mag|abs|amplitude|ampl?",
    "phase": r"phase|phi|arg|angle",
    "real": r"real|re|inphase|in-phase",
    "imaginary": r"imaginary|imag|im|quadrature|quad",
}
PART = re.compile(
    r"(?P<stem>.*?)[ _.:-]*(?:"
    + "|".join(rf"(?P<{part}>{words})" for part, words in PARTS.items())
    + r")(?P<unit>[ _([]*(?:deg|degrees|rad|°)[)\]]?)?",
    re.IGNORECASE,
)
ELECTRODES = ("a", "b", "m", "n")
READINGS = {  # of a row: name, unit
    "r": "ohm", "r_ohm": "ohm", "rho": "ohm", "resist": "ohm", "resistance": "ohm",
    "u": "V", "u_v": "V", "v": "V", "voltage": "V", "voltage_v": "V", "potential": "V",
}  # fmt: skip
FRAMES = ("frame", "scan", "frame_id")


def combined(path: Path, names: list[str], values: np.ndarray) -> tuple[list[str], np.ndarray, str]:
    """Names without the part and complex readings (F, C / 2) of columns (F, C) that hold two parts
    of each, and a remark; names and columns as they are where they do not.

    Phases are in degrees where one is beyond 2 pi, or as the names say; where neither tells, only
    magnitudes are taken. Raises InputError where a part of a reading is missing.
    """
    matches = [match for name in names if (match := PART.fullmatch(name))]
    if not names or len(matches) < len(names):
        return names, values, ""
    columns: dict[str, dict[str, int]] = {}
    for k, match in enumerate(matches):
        part = next(part for part in PARTS if match[part])
        columns.setdefault(match["stem"], {})[part] = k
    kinds = {tuple(sorted(parts)) for parts in columns.values()}
    if kinds == {("magnitude",)}:
        return list(columns), values, ""
    if len(kinds) > 1 or kinds <= {("phase",), ("real",), ("imaginary",)}:
        actual = f"columns of {', '.join(sorted({part for kind in kinds for part in kind}))}"
        expected = "magnitude and phase, or real and imaginary part, of each reading"
        raise InputError(path, "columns", actual, expected)
    stems = list(columns)
    if kinds == {("imaginary", "real")}:
        real, imaginary = (
            values[:, [columns[stem][part] for stem in stems]] for part in ("real", "imaginary")
        )
        return stems, real + 1j * imaginary, "real and imaginary parts"
    if kinds != {("magnitude", "phase")}:
        raise InputError(path, "columns", "more than two parts of each reading", "two")
    magnitude, phase = (
        values[:, [columns[stem][part] for stem in stems]] for part in ("magnitude", "phase")
    )
    units = " ".join(match["unit"] or "" for match in matches).lower()
    if "rad" in units:
        turn, unit = 1.0, "radians"
    elif "deg" in units or "°" in units or np.nanmax(np.abs(phase), initial=0.0) > 2.0 * np.pi:
        turn, unit = np.pi / 180.0, "degrees"
    else:
        return stems, magnitude, "phases left out: nothing says whether degrees or radians"
    return stems, magnitude * np.exp(1j * turn * phase), f"magnitudes and phases in {unit}"


def channels(names: list[str]) -> list[list[int]] | None:
    """The channels [source, sink, plus, minus] in columns' names of four numbers each; None where a
    name has others."""
    numbers = [[int(number) for number in re.findall(r"\d+", name)] for name in names]
    if not names or any(len(electrodes) != len(ELECTRODES) for electrodes in numbers):
        return None
    return _from_zero(numbers)


def _from_zero(channels: list[list[int]]) -> list[list[int]]:
    lowest_number = 0 if min(map(min, channels)) == 0 else 1
    return [[electrode - lowest_number for electrode in channel] for channel in channels]


def is_row_a_reading(names: list[str]) -> bool:
    """Whether columns name the electrodes of one reading."""
    lower = [name.lower() for name in names]
    return {*ELECTRODES} <= {*lower} and any(name in READINGS for name in lower)


def refuse_unnamed_rows(path: Path, names: list[str], values: np.ndarray) -> None:
    """Raise InputError for a table (R, C) that seems to have a reading a row, but whose columns'
    names do not tell its electrodes, or its reading."""
    lower = [name.lower() for name in names]
    if {*ELECTRODES} <= {*lower}:
        columns = [lower.index(name) for name in ELECTRODES]
    else:
        is_number = (values == np.round(values)) & (np.abs(values) <= MAX_ELECTRODES)
        columns = [
            k for k, name in enumerate(lower) if is_number[:, k].all() and name not in FRAMES
        ]
        if len(columns) != len(ELECTRODES):
            return
    a, b, m, n = values[:, columns].T
    if (a == b).any() or (m == n).any():
        return
    electrodes = ", ".join(names[k] for k in columns)
    spare_columns = ", ".join(name for k, name in enumerate(names) if k not in columns)
    violation = f"{electrodes}, as of a reading a row, and {spare_columns}"
    expected = (
        "electrodes named a, b (drive), m, n (measurement), and the reading r (ohm) or u (V); an"
        " apparent resistivity over its geometric factor"
    )
    raise InputError(path, "columns", violation, expected)


def frames_of_rows(
    path: Path, names: list[str], values: np.ndarray, lines: list[int]
) -> tuple[np.ndarray, list[list[int]], str]:
    """Frames (F, M), their channels and their unit, of a table (R, C) with a reading a row.

    Without a column of frames, one begins where the first channel comes again. A reading that a
    frame lacks is NaN. Raises InputError for one that it has twice.
    """
    lower = [name.lower() for name in names]
    rows = values[:, [lower.index(name) for name in ELECTRODES]]
    is_integer = np.isfinite(rows).all(axis=1) & (rows == np.round(rows)).all(axis=1)
    if not is_integer.all():
        line = lines[int(np.flatnonzero(~is_integer)[0])]
        raise InputError(path, f"line {line}, columns a, b, m, n", "no electrode", "whole numbers")
    numbers = [tuple(row) for row in rows.astype(int).tolist()]
    reading = next(name for name in lower if name in READINGS)
    frame_column = next((name for name in FRAMES if name in lower), None)
    if frame_column is None:
        frame = np.cumsum([channel == numbers[0] for channel in numbers]) - 1
    else:
        _, frame = np.unique(values[:, lower.index(frame_column)], return_inverse=True)
    place_of = {channel: k for k, channel in enumerate(dict.fromkeys(numbers))}
    frames = np.full((int(frame.max()) + 1, len(place_of)), np.nan, values.dtype)
    filled = np.zeros(frames.shape, dtype=bool)
    for k, (row, channel) in enumerate(zip(frame, numbers, strict=True)):
        place = row, place_of[channel]
        if filled[place]:
            actual = f"channel {', '.join(map(str, channel))} again in frame {row}"
            raise InputError(path, f"line {lines[k]}", actual, "each once a frame")
        filled[place] = True
        frames[place] = values[k, lower.index(reading)]
    return frames, _from_zero([list(channel) for channel in place_of]), READINGS[reading]
