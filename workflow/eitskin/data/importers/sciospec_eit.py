"""Sciospec `.eit`: a text file a frame, potentials of every channel for every injection.

By Sciospec's EIT software and the readers of others (`fnc_read_SciospecData.m` of
erutkovskis/Sciospec, `doteit.py` of spatialaudio/sciopy): the first line counts the lines of the
header; in order version (from 11 lines on), setup, date, lowest and highest frequency (Hz), scale
(0 linear, 1 logarithmic), number of frequencies, amplitude (A), frame rate, phase correction, gain,
range, measure mode (1: potentials against ground), boundary, switch type, then the lists
`MeasurementChannels:` (the setup's electrodes) and
`MeasurementChannelsIndependentFromInjectionPattern:` (all that are read). Then for every injection
a line `source sink` and a line of real and imaginary parts for every frequency; numbers from 1.

Potentials against ground hold the contacts' and the ground's own; their differences u[j] - u[j+1]
round the ring are readings, where neither electrode drives (`measure` names another pair). Frames
are nobody's touches: they are taken for untouched. A folder holds the frames of one setup, in the
order of the last number in their names.
"""

import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from eitskin import text_file
from eitskin.data.importers.bare_vectors import UNTOUCHED, pairs, said
from eitskin.data.importers.description import describe
from eitskin.data.importers.tables import first_line
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import undriven

LEFT_OPEN = ("measure",)
MEASURE = "adjacent"
LEAST_LINES, WITH_VERSION = 9, 11  # of a header, and from which on it tells its version
HEADER = {  # by place in a header that tells its version
    "date": 3,
    "lowest frequency": 4,
    "highest frequency": 5,
    "frequency scale": 6,
    "number of frequencies": 7,
    "amplitude": 8,
}
MEASURE_MODE, POTENTIALS = 13, 1
SETUP, READ = "MeasurementChannels:", "MeasurementChannelsIndependentFromInjectionPattern:"
SOURCE = "Sciospec {name} ({said})"


@dataclass(frozen=True)
class Frame:
    """One file: `drives` (K, 2) and `potentials` (K, E) complex, V, of the electrodes `ring` (E,)
    in rising order, all numbered from 1; the other frequencies are left out."""

    date: datetime | None
    frequencies: str
    amplitude_A: float
    ring: tuple[int, ...]
    drives: np.ndarray
    potentials: np.ndarray

    @property
    def setup(self) -> tuple:
        """What all frames of a folder share."""
        return self.frequencies, self.amplitude_A, self.ring, self.drives.tolist()


def matches(path: Path) -> bool:
    """Whether the file, or a folder's first, is named `.eit` and begins with a whole number."""
    found = files(path)[:1]
    return bool(found) and found[0].suffix.lower() == ".eit" and first_line(found[0]).isdecimal()


def refusal(path: Path) -> InputError | None:
    """Of another maker's file with the same ending."""
    if path.suffix.lower() != ".eit" or not path.is_file():
        return None
    found = "no Sciospec .eit (Draeger, Carefusion and Swisstom name theirs so as well)"
    return InputError(path, "line 1", found, "how many lines the header has")


def files(path: Path) -> list[Path]:
    """The frames, one a file."""
    if not path.is_dir():
        return [path]
    frames = (file for file in path.iterdir() if file.suffix.lower() == ".eit")
    return sorted(frames, key=lambda file: (_last_number(file.stem), file.name))


def load(path: Path, measure: str | None = None) -> Recording:
    """One frame a file; raises InputError where one is cut short or of another setup than the
    first, and where time stands still."""
    found = files(path)
    if not found:
        raise InputError(path, "folder", "no *.eit", "the frames of one setup")
    frames = [_read(file) for file in found]
    for file, frame in zip(found, frames, strict=True):
        if frame.setup != frames[0].setup:
            expected = f"that of {found[0].name}: frequencies, amplitude, electrodes, injections"
            raise InputError(file, "setup", "another", expected)
    first, measure = frames[0], measure or MEASURE
    channels = _channels(path, first, measure)
    potentials = np.stack([frame.potentials for frame in frames])
    drive = np.repeat(np.arange(len(first.drives)), len(first.ring))
    kept = undriven(channels)
    _, _, plus, minus = channels.T
    readings = (potentials[:, drive, plus] - potentials[:, drive, minus])[:, kept]
    parts = said(
        f"differences of potentials made: {measure} pairs where neither electrode drives",
        first.frequencies,
        f"electrodes {first.ring} counted from 0" if first.ring[-1] != len(first.ring) else "",
        UNTOUCHED,
    )
    metadata = describe(
        channels[kept],
        even_angles(len(first.ring)),
        SOURCE.format(name=path.name, said=parts),
        "signed",
        unit="V",
        clock="measured" if len(frames) > 1 else "index",
        skin={"current_A": first.amplitude_A},
    )
    table = frames_table(_times(found, frames), np.zeros(len(frames), dtype=bool))
    return Recording(table, readings.real, readings.imag, None, metadata)


def _last_number(stem: str) -> int:
    numbers = re.findall(r"\d+", stem)
    return int(numbers[-1]) if numbers else -1


def _channels(path: Path, frame: Frame, measure: str) -> np.ndarray:
    """(K E, 4): for every drive all measured pairs, electrodes by their place in the ring."""
    n = len(frame.ring)
    drives = np.searchsorted(frame.ring, frame.drives)
    measured = pairs(path, n, MEASURE, measure)[:n, 2:]
    return np.concatenate([np.repeat(drives, n, axis=0), np.tile(measured, (len(drives), 1))], 1)


def _times(files: list[Path], frames: list[Frame]) -> np.ndarray:
    """(N,) seconds from the first; raises InputError where a date is missing or stands still."""
    if len(frames) == 1:
        return np.zeros(1)
    dates = []
    for file, frame in zip(files, frames, strict=True):
        if frame.date is None:
            raise InputError(file, "header, date", "none", "yyyy.mm.dd. hh:mm:ss.fff")
        dates.append(frame.date)
    time = np.array([(date - dates[0]).total_seconds() for date in dates])
    still = np.flatnonzero(np.diff(time) <= 0)
    if len(still):
        file, before = files[still[0] + 1], files[still[0]]
        found = frames[still[0] + 1].date
        raise InputError(file, "header, date", found, f"one after that of {before.name}")
    return time


def _read(path: Path) -> Frame:
    lines = text_file.read(path).splitlines()
    count = lines[0].strip() if lines else ""
    if not count.isdecimal() or not LEAST_LINES <= int(count) < len(lines):
        raise InputError(path, "line 1", repr(count), "how many lines the header has")
    header = [line.strip() for line in lines[: int(count)]]
    if len(header) < WITH_VERSION:
        header.insert(1, "1")
    values = {name: header[at] for name, at in HEADER.items()}
    n_frequencies = int(_number(path, values, "number of frequencies"))
    if n_frequencies < 1:
        raise InputError(path, "header, number of frequencies", n_frequencies, "1 or more")
    mode = header[MEASURE_MODE] if len(header) > MEASURE_MODE else ""
    if mode.isdecimal() and int(mode) > POTENTIALS:
        raise InputError(path, "header, measure mode", mode, f"{POTENTIALS}: potentials")
    drives, potentials = _blocks(path, lines, int(count), n_frequencies)
    ring, columns = _electrodes(path, header, drives, potentials.shape[1])
    return Frame(
        date=_date(path, values["date"]),
        frequencies=_frequencies(path, values, n_frequencies),
        amplitude_A=_number(path, values, "amplitude"),
        ring=ring,
        drives=drives,
        potentials=potentials[:, columns],
    )


def _blocks(
    path: Path, lines: list[str], start: int, n_frequencies: int
) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) electrodes from 1 and (K, C) potentials at the first frequency, C channels."""
    body = [(k + 1, line.split()) for k, line in enumerate(lines) if k >= start and line.strip()]
    block = 1 + n_frequencies
    if not body or len(body) % block:
        found = f"{len(body)} lines after the header"
        expected = f"whole injections of {block}, one of electrodes and {n_frequencies} of numbers"
        raise InputError(path, "lines", found, expected)
    drives, potentials = [], []
    for k in range(0, len(body), block):
        number, cells = body[k]
        if len(cells) != 2 or not all(cell.isdecimal() for cell in cells):
            raise InputError(path, f"line {number}", " ".join(cells[:4]), "source and sink")
        drives.append([int(cell) for cell in cells])
        for other, cells in body[k + 1 : k + block]:
            if len(cells) != len(body[1][1]) or len(cells) % 2:
                expected = f"{len(body[1][1])}, real and imaginary of every channel"
                raise InputError(path, f"line {other}", f"{len(cells)} numbers", expected)
        number, cells = body[k + 1]
        try:
            numbers = np.array([float(cell) for cell in cells])
        except ValueError as error:
            raise InputError(path, f"line {number}", str(error), "numbers") from error
        if np.isinf(numbers).any():
            raise InputError(path, f"line {number}", "an infinite number", "numbers")
        potentials.append(numbers[0::2] + 1j * numbers[1::2])
    return np.array(drives), np.array(potentials)


def _electrodes(
    path: Path, header: list[str], drives: np.ndarray, n_columns: int
) -> tuple[tuple[int, ...], list[int]]:
    """The ring's electrodes, rising, and the column of each: the setup's where the header lists
    them, else those that drive."""
    lists = {}
    for line in header:
        name, colon, rest = line.partition(":")
        if name + colon in (SETUP, READ):
            cells = [cell for cell in re.split(r"[,\s]+", rest) if cell]
            if not all(cell.isdecimal() for cell in cells):
                raise InputError(path, f"header, {name}", rest.strip(), "numbers of channels")
            lists[name + colon] = [int(cell) for cell in cells]
    for columns in (lists.get(READ, []), lists.get(SETUP, []), list(range(1, n_columns + 1))):
        if len(set(columns)) == n_columns:
            break
    ring = sorted({*(lists.get(SETUP) or drives.ravel().tolist()), *drives.ravel().tolist()})
    missing = [electrode for electrode in ring if electrode not in columns]
    if missing:
        found = f"electrode {missing[0]}, which none of the {n_columns} channels reads"
        raise InputError(path, "injections", found, f"electrodes among {columns}")
    same = np.flatnonzero(drives[:, 0] == drives[:, 1])
    if len(same):
        raise InputError(path, f"injection {same[0]}", drives[same[0]].tolist(), "two electrodes")
    return tuple(ring), [columns.index(electrode) for electrode in ring]


def _number(path: Path, values: dict[str, str], name: str) -> float:
    try:
        return float(values[name])
    except ValueError as error:
        raise InputError(path, f"header, {name}", repr(values[name]), "a number") from error


def _frequencies(path: Path, values: dict[str, str], count: int) -> str:
    """What `source` says of them."""
    low = _number(path, values, "lowest frequency")
    if count == 1:
        return f"{low:g} Hz"
    high = _number(path, values, "highest frequency")
    return f"{low:g} Hz, the first of {count} frequencies to {high:g} Hz, the others left out"


def _date(path: Path, text: str) -> datetime | None:
    if not text:
        return None
    for form in ("%Y.%m.%d. %H:%M:%S.%f", "%Y.%m.%d. %H:%M:%S"):
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    raise InputError(path, "header, date", repr(text), "yyyy.mm.dd. hh:mm:ss.fff")
