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
from eitskin.data.importers.bare_vectors import UNTOUCHED, join_remarks, pattern_channels
from eitskin.data.importers.description import describe
from eitskin.data.importers.tables import first_line
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import undriven

LEFT_OPEN = ("measure", "frequency")
MEASURE = "adjacent"
MIN_HEADER_LINES, MIN_VERSION_LINES = 9, 11  # of a header, and from which on it tells its version
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
SOURCE = "Sciospec {name} ({remarks})"


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
        """The settings that all frames of a folder share."""
        return self.frequencies, self.amplitude_A, self.ring, self.drives.tolist()


def matches(path: Path) -> bool:
    """Whether the file, or a folder's first, is named `.eit` and begins with a whole number."""
    frame_files = files(path)[:1]
    return (
        bool(frame_files)
        and frame_files[0].suffix.lower() == ".eit"
        and first_line(frame_files[0]).isdecimal()
    )


def accepts(path: Path) -> bool:
    """Never; raises InputError for another maker's file with the same ending."""
    if path.suffix.lower() == ".eit" and path.is_file():
        violation = "no Sciospec .eit (Draeger, Carefusion and Swisstom name theirs so as well)"
        raise InputError(path, "line 1", violation, "how many lines the header has")
    return False


def files(path: Path) -> list[Path]:
    """The frames, one a file."""
    if not path.is_dir():
        return [path]
    frames = (file for file in path.iterdir() if file.suffix.lower() == ".eit")
    return sorted(frames, key=lambda file: (_last_number(file.stem), file.name))


def load(path: Path, measure: str | None = None, frequency: float | None = None) -> Recording:
    """One frame a file, at `frequency` in Hz, by default the first.

    Raises InputError where one is cut short or of another setup than the first, where time stands
    still, and for an unknown frequency.
    """
    frame_files = files(path)
    if not frame_files:
        raise InputError(path, "folder", "no *.eit", "the frames of one setup")
    frames = [_read(file, frequency) for file in frame_files]
    for file, frame in zip(frame_files, frames, strict=True):
        if frame.setup != frames[0].setup:
            expected = (
                f"that of {frame_files[0].name}: frequencies, amplitude, electrodes, injections"
            )
            raise InputError(file, "setup", "another", expected)
    first_frame, measure = frames[0], measure or MEASURE
    channels = _channels(path, first_frame, measure)
    potentials = np.stack([frame.potentials for frame in frames])
    drive = np.repeat(np.arange(len(first_frame.drives)), len(first_frame.ring))
    is_undriven = undriven(channels)
    _, _, plus, minus = channels.T
    readings = (potentials[:, drive, plus] - potentials[:, drive, minus])[:, is_undriven]
    parts = join_remarks(
        f"differences of potentials made: {measure} pairs where neither electrode drives",
        first_frame.frequencies,
        f"electrodes {first_frame.ring} counted from 0"
        if first_frame.ring[-1] != len(first_frame.ring)
        else "",
        UNTOUCHED,
    )
    metadata = describe(
        channels[is_undriven],
        even_angles(len(first_frame.ring)),
        SOURCE.format(name=path.name, remarks=parts),
        "signed",
        unit="V",
        clock="measured" if len(frames) > 1 else "index",
        skin={"current_A": first_frame.amplitude_A},
    )
    table = frames_table(_times(frame_files, frames), np.zeros(len(frames), dtype=bool))
    return Recording(table, readings.real, readings.imag, None, metadata)


def _last_number(stem: str) -> int:
    numbers = re.findall(r"\d+", stem)
    return int(numbers[-1]) if numbers else -1


def _channels(path: Path, frame: Frame, measure: str) -> np.ndarray:
    """Channels (K E, 4): for every drive all measured pairs, by their place in the ring."""
    n = len(frame.ring)
    drives = np.searchsorted(frame.ring, frame.drives)
    measured = pattern_channels(path, n, MEASURE, measure)[:n, 2:]
    return np.concatenate([np.repeat(drives, n, axis=0), np.tile(measured, (len(drives), 1))], 1)


def _times(files: list[Path], frames: list[Frame]) -> np.ndarray:
    """Seconds (N,) from the first frame; raises InputError where dates are missing or do not
    increase."""
    if len(frames) == 1:
        return np.zeros(1)
    dates = []
    for file, frame in zip(files, frames, strict=True):
        if frame.date is None:
            raise InputError(file, "header, date", "none", "yyyy.mm.dd. hh:mm:ss.fff")
        dates.append(frame.date)
    time = np.array([(date - dates[0]).total_seconds() for date in dates])
    stalled = np.flatnonzero(np.diff(time) <= 0)
    if len(stalled):
        file, previous_file = files[stalled[0] + 1], files[stalled[0]]
        stalled_date = frames[stalled[0] + 1].date
        raise InputError(
            file, "header, date", stalled_date, f"one after that of {previous_file.name}"
        )
    return time


def _read(path: Path, frequency: float | None) -> Frame:
    lines = text_file.read(path).splitlines()
    count = lines[0].strip() if lines else ""
    if not count.isdecimal() or not MIN_HEADER_LINES <= int(count) < len(lines):
        raise InputError(path, "line 1", repr(count), "how many lines the header has")
    header = [line.strip() for line in lines[: int(count)]]
    if len(header) < MIN_VERSION_LINES:
        header.insert(1, "1")
    values = {name: header[line_index] for name, line_index in HEADER.items()}
    n_frequencies = int(_number(path, values, "number of frequencies"))
    if n_frequencies < 1:
        raise InputError(path, "header, number of frequencies", n_frequencies, "1 or more")
    mode = header[MEASURE_MODE] if len(header) > MEASURE_MODE else ""
    if mode.isdecimal() and int(mode) > POTENTIALS:
        raise InputError(path, "header, measure mode", mode, f"{POTENTIALS}: potentials")
    frequencies = _frequencies(path, values, n_frequencies)
    place = 0 if frequency is None else int(np.argmin(np.abs(frequencies - frequency)))
    if frequency is not None and not np.isclose(frequencies[place], frequency, rtol=1e-3):
        expected = f"one of {', '.join(f'{value:g}' for value in frequencies)} Hz"
        raise InputError(path, "setting frequency", f"{frequency:g} Hz", expected)
    drives, potentials = _blocks(path, lines, int(count), n_frequencies, place)
    ring, columns = _electrodes(path, header, drives, potentials.shape[1])
    return Frame(
        date=_date(path, values["date"]),
        frequencies=_frequency_text(frequencies, place),
        amplitude_A=_number(path, values, "amplitude"),
        ring=ring,
        drives=drives,
        potentials=potentials[:, columns],
    )


def _blocks(
    path: Path, lines: list[str], start: int, n_frequencies: int, place: int
) -> tuple[np.ndarray, np.ndarray]:
    """Electrodes (K, 2), from 1, and potentials (K, C) of C channels at one frequency."""
    body = [(k + 1, line.split()) for k, line in enumerate(lines) if k >= start and line.strip()]
    block = 1 + n_frequencies
    if not body or len(body) % block:
        violation = f"{len(body)} lines after the header"
        expected = f"whole injections of {block}, one of electrodes and {n_frequencies} of numbers"
        raise InputError(path, "lines", violation, expected)
    drives, potentials = [], []
    for k in range(0, len(body), block):
        number, cells = body[k]
        if len(cells) != 2 or not all(cell.isdecimal() for cell in cells):
            raise InputError(path, f"line {number}", " ".join(cells[:4]), "source and sink")
        drives.append([int(cell) for cell in cells])
        for line_number, cells in body[k + 1 : k + block]:
            if len(cells) != len(body[1][1]) or len(cells) % 2:
                expected = f"{len(body[1][1])}, real and imaginary of every channel"
                raise InputError(path, f"line {line_number}", f"{len(cells)} numbers", expected)
        number, cells = body[k + 1 + place]
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
    """The ring's electrodes in rising order and the column of each.

    They are the setup's where the header lists them, else those that drive.
    """
    lists = {}
    for line in header:
        name, colon, value_text = line.partition(":")
        if name + colon in (SETUP, READ):
            cells = [cell for cell in re.split(r"[,\s]+", value_text) if cell]
            if not all(cell.isdecimal() for cell in cells):
                raise InputError(path, f"header, {name}", value_text.strip(), "numbers of channels")
            lists[name + colon] = [int(cell) for cell in cells]
    for columns in (lists.get(READ, []), lists.get(SETUP, []), list(range(1, n_columns + 1))):
        if len(set(columns)) == n_columns:
            break
    ring = sorted({*(lists.get(SETUP) or drives.ravel().tolist()), *drives.ravel().tolist()})
    missing = [electrode for electrode in ring if electrode not in columns]
    if missing:
        violation = f"electrode {missing[0]}, which none of the {n_columns} channels reads"
        raise InputError(path, "injections", violation, f"electrodes among {columns}")
    equal_pairs = np.flatnonzero(drives[:, 0] == drives[:, 1])
    if len(equal_pairs):
        raise InputError(
            path, f"injection {equal_pairs[0]}", drives[equal_pairs[0]].tolist(), "two electrodes"
        )
    return tuple(ring), [columns.index(electrode) for electrode in ring]


def _number(path: Path, values: dict[str, str], name: str) -> float:
    try:
        return float(values[name])
    except ValueError as error:
        raise InputError(path, f"header, {name}", repr(values[name]), "a number") from error


def _frequencies(path: Path, values: dict[str, str], count: int) -> np.ndarray:
    """(count,) the frequencies in Hz, evenly spaced on the stated scale."""
    low = _number(path, values, "lowest frequency")
    if count == 1:
        return np.array([low])
    high = _number(path, values, "highest frequency")
    is_logarithmic = values["frequency scale"] == "1" and low > 0 and high > 0
    return np.geomspace(low, high, count) if is_logarithmic else np.linspace(low, high, count)


def _frequency_text(frequencies: np.ndarray, place: int) -> str:
    """The frequencies in words, for `source`."""
    text = f"{frequencies[place]:g} Hz"
    if len(frequencies) == 1:
        return text
    ordinal = "the first of" if place == 0 else f"number {place + 1} of"
    count = f"{ordinal} {len(frequencies)} frequencies to {frequencies[-1]:g} Hz"
    return f"{text}, {count}, the others left out (--frequency)"


def _date(path: Path, text: str) -> datetime | None:
    if not text:
        return None
    for form in ("%Y.%m.%d. %H:%M:%S.%f", "%Y.%m.%d. %H:%M:%S"):
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    raise InputError(path, "header, date", repr(text), "yyyy.mm.dd. hh:mm:ss.fff")
