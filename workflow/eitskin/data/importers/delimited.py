"""Tables of cells in text: commas, semicolons, tabs or spaces; decimal points or commas.

UTF-8, with or without a byte-order mark, UTF-16 with one, and Windows-1252 in names. Empty lines
and lines that begin with # are skipped. The first line names the columns where it holds words,
beside words only whole numbers; a line of units may follow. A comma within a number is the decimal
point where semicolons, tabs or spaces separate numbers. Complex numbers are a+bi or (a+bj).

Boards write two other layouts: a frame over several lines, with a word in the line before each, and
OpenEIT's log, `magnitudes : ...`, alone or in the cells of another table, of which its column of
times is read, nothing else. A workbook of Excel is read by its first sheet where openpyxl is
installed.
"""

import csv
import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path

import numpy as np

from eitskin import text_file
from eitskin.data.importers import workbook
from eitskin.errors import InputError
from eitskin.progress import patient

LOST = (
    *("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"),
    *("ovf", "ovr", "ovld", "ol", "overflow", "overload", "overrange"),
)
UNITS = (
    *(
        "s",
        "ms",
        "us",
        "min",
        "mm",
        "cm",
        "m",
        "um",
        "N",
        "mN",
        "kN",
        "g",
        "kg",
        "deg",
        "°",
        "°C",
        "C",
    ),
    *("V", "mV", "uV", "µV", "μV", "ohm", "mohm", "kohm", "Ω", "A", "mA", "uA", "Hz", ""),
)
MAX_DRIVE_NUMBERS = 32  # one an electrode
TIMES = ("time", "time_s", "t", "timestamp", "date", "datetime")  # names of a log's column
LOGGED = re.compile(r"\bmagnitudes\s*:([^\"\n]*)", re.IGNORECASE)


@dataclass(frozen=True)
class Cells:
    """`rows` of cells of one length, their `lines` in the file, from 1, the columns' `names` if
    any, whether numbers have a decimal `comma`, and a `remark` on what is not read."""

    path: Path
    names: list[str] | None
    rows: list[list[str]]
    lines: list[int]
    comma: bool
    remark: str = ""

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])

    def words(self, column: int) -> list[str | None]:
        """The cells of a column; None where one is empty."""
        return [row[column] or None for row in self.rows]

    def numbers(self, columns: list[int]) -> np.ndarray:
        """(rows, len(columns)) float64, or complex128 where a cell is; NaN where one is of LOST.

        Raises InputError naming line and column for what is no finite number.
        """
        table = np.empty((len(self.rows), len(columns)))
        for k, row in enumerate(patient(self.rows, f"reading {self.path.name}")):
            try:
                numbers = [number(row[column], self.comma) for column in columns]
            except ValueError:
                bad_column = next(
                    column for column in columns if not is_number(row[column], self.comma)
                )
                name = self.names[bad_column] if self.names else bad_column
                place = f"line {self.lines[k]}, column {name}"
                raise InputError(self.path, place, repr(row[bad_column]), "a number") from None
            if table.dtype != complex and any(isinstance(value, complex) for value in numbers):
                table = table.astype(complex)
            table[k] = numbers
        return table


def read(path: Path) -> Cells:
    """The cells of a text file.

    Raises InputError where it is no text, has no row of cells, rows of different lengths, or
    decimal points beside decimal commas.
    """
    logged: list[tuple[int, str]] = []
    if workbook.is_workbook(path):
        lines = workbook.lines(path)
    else:
        text = text_file.read_table(path)
        logged = [
            (1 + text.count("\n", 0, match.start()), match[1].strip(" \r,"))
            for match in LOGGED.finditer(text)
        ]
        lines = logged or [
            (k + 1, line.strip(" \r"))
            for k, line in enumerate(text.split("\n"))
            if line.strip() and not line.lstrip().startswith("#")
        ]
    if not lines:
        raise InputError(path, "file", "no line of cells", "a row a frame")
    usual_line = max(lines, key=lambda line: len(line[1]))[1]
    if lines[0][1] == usual_line and len(lines) > 1:
        usual_line = max(lines[1:], key=lambda line: len(line[1]))[1]
    separator = _separator(usual_line)
    rows = [[cell.strip(' "') for cell in line.split(separator)] for _, line in lines]
    if len(rows[0]) > 1 and all(row[-1] == "" for row in rows):
        rows = [row[:-1] for row in rows]  # a separator at the end of every line
    rows, lines = _joined(path, rows, lines)
    usual_row = [cell.strip(' "') for cell in usual_line.split(separator)]
    if separator == ",":
        _refuse_decimal_commas(path, usual_row)
    comma = separator != "," and any("," in cell for cell in usual_row)
    names = head = None
    if _is_names(path, rows[0], lines[0][0], comma):
        names, rows, lines = rows[0], rows[1:], lines[1:]
        head = names
        if _is_units(rows, comma):
            names, rows, lines = _with_units(names, rows[0]), rows[1:], lines[1:]
    if not rows:
        raise InputError(path, "file", "no row below the names", "a row a frame")
    width = len(names or rows[0])
    for (number_, line), row in zip(lines, rows, strict=True):
        if len(row) != width:
            expected = f"{width}"
            if row is rows[-1] and len(row) < width:
                expected += "; where the logger was stopped in this last line, delete it"
            raise InputError(path, f"line {number_}", f"{len(row)} cells", expected)
        if row == head:
            expected = "one table a file: what follows is another recording"
            raise InputError(path, f"line {number_}", "the line of names again", expected)
        if comma and "." in line and any(is_number(cell, False) for cell in row if "." in cell):
            expected = "decimal points or decimal commas throughout"
            raise InputError(path, f"line {number_}", "both", expected)
    remark = ""
    if logged:
        remark = "OpenEIT's log, of which the magnitudes alone are read"
        times = _log_times(text)
        if len(times) == len(rows) and (np.diff(times) > 0.0).all():
            remark = "OpenEIT's log, of which times and magnitudes alone are read"
            names = ["time_s", *map(str, range(width))]
            rows = [[repr(time), *row] for time, row in zip(times, rows, strict=True)]
    return Cells(path, names, rows, [number_ for number_, _ in lines], comma, remark)


def _is_units(rows: list[list[str]], comma: bool) -> bool:
    """Whether the first row has the units of the numbers below."""
    units = [cell.strip("[]()") for cell in rows[0]] if rows else []
    return (
        len(rows) > 1
        and len(rows[1]) == len(units)
        and all(unit in UNITS for unit in units)
        and any(unit and is_number(cell, comma) for unit, cell in zip(units, rows[1], strict=True))
    )


def _with_units(names: list[str], units: list[str]) -> list[str]:
    """Names of columns with the units in the line below them, where they do not end so."""
    return [
        name if not unit or name.endswith(unit.strip("[]()")) else f"{name} [{unit.strip('[]()')}]"
        for name, unit in zip(names, units, strict=True)
    ]


def table(path: Path, columns: int) -> np.ndarray:
    """(rows, columns) float64 of a text file without names; raises InputError as `read` and
    `Cells.numbers` do, and for another number of columns."""
    cells = read(path)
    if cells.names:
        raise InputError(path, "line 1", repr(", ".join(cells.names)[:60]), "numbers alone")
    if cells.width != columns:
        place = f"line {cells.lines[0]}"
        raise InputError(path, place, f"{cells.width} cells", f"{columns}")
    return cells.numbers(list(range(columns)))


def begins_with_row(path: Path, width: int) -> bool:
    """Whether the first line of a file that is no comment has so many cells."""
    lines = (line.strip() for line in path.read_bytes().decode("latin-1").splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return len(re.split(r"[;,\t ]+", first)) >= width


def number(cell: str, comma: bool) -> float | complex:
    """The real or complex number in a cell, NaN where it is one of LOST; raises ValueError for
    other words and for infinity."""
    if cell.lower() in LOST:
        return math.nan
    text = cell.replace(",", ".") if comma else cell
    try:
        value: float | complex = float(text)
    except ValueError:
        value = complex(text.replace(" ", "").lower().replace("i", "j"))
    if not np.isfinite(value):
        raise ValueError(cell)
    return value


def is_number(cell: str, comma: bool) -> bool:
    """Whether a cell holds a number or one of LOST."""
    try:
        number(cell, comma)
    except ValueError:
        return False
    return True


def _log_times(text: str) -> list[float]:
    """Seconds of the rows of a table whose cells hold a log; none without a column of times.

    Times are numbers, in seconds, or of ISO 8601.
    """
    head = text.partition("\n")[0]
    separator = _separator(head)
    names = [cell.strip(' "').lower() for cell in head.split(separator)]
    column = next((k for k, name in enumerate(names) if name in TIMES), None)
    if column is None or LOGGED.search(head):
        return []
    try:
        table = list(csv.reader(StringIO(text), delimiter=separator or " "))
        times = [row[column] for row in table if any(map(LOGGED.search, row))]
        return [seconds(time.strip()) for time in times]
    except (csv.Error, IndexError, ValueError):
        return []


def seconds(time: str) -> float:
    """A number of seconds, or the seconds since 1970 of a time of ISO 8601, UTC where it has no
    zone; raises ValueError for others."""
    try:
        return float(time)
    except ValueError:
        moment = datetime.fromisoformat(time)
        return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()


def _joined(
    path: Path, rows: list[list[str]], lines: list[tuple[int, str]]
) -> tuple[list[list[str]], list[tuple[int, str]]]:
    """Rows that a word in a line of its own precedes, each frame's in one; the others as they are.

    Raises InputError where a frame has another number of lines than the first.
    """
    marks = [k for k, row in enumerate(rows) if len(row) == 1 and not is_number(row[0], False)]
    words = {re.sub(r"\d+", "", rows[k][0]) for k in marks}
    if len(words) != 1 or marks[0] or max(map(len, rows)) < 2:
        return rows, lines
    blocks = list(zip(marks, [*marks[1:], len(rows)], strict=True))
    if len(blocks) == 1:  # a head; of a drive's numbers in each row, else another format's
        is_head = max(map(len, rows)) <= MAX_DRIVE_NUMBERS
        return (rows[1:], lines[1:]) if is_head else (rows, lines)
    count = blocks[0][1] - blocks[0][0] - 1
    for start, end in blocks:
        if end - start - 1 != count or not count:
            found = f"{end - start - 1} lines of numbers after it"
            raise InputError(path, f"line {lines[start][0]}", found, f"{count or 'some'}")
    frames = [[cell for row in rows[start + 1 : end] for cell in row] for start, end in blocks]
    return frames, [(lines[start + 1][0], lines[start + 1][1]) for start, _ in blocks]


def _refuse_decimal_commas(path: Path, row: list[str]) -> None:
    """Raise InputError where commas are decimal points and stand between the numbers as well."""
    wholes, decimals = row[::2], row[1::2]
    if (
        len(wholes) == len(decimals)
        and all(re.fullmatch(r"[-+]?\d+", cell) for cell in wholes)
        and all(re.fullmatch(r"\d+(e[-+]?\d+)?", cell, re.IGNORECASE) for cell in decimals)
        and (  # which counts of a converter have not
            any(re.match("[-+]", cell) for cell in wholes)
            or any(re.match(r"0\d", cell) for cell in decimals)
            or min(map(len, decimals)) > max(map(len, wholes))
        )
    ):
        found = "decimal commas, and commas between the numbers"
        expected = "semicolons or tabs between the numbers, or decimal points"
        raise InputError(path, "lines", found, expected)


def _is_names(path: Path, row: list[str], line: int, comma: bool) -> bool:
    """Whether the first row names the columns.

    Raises InputError where it numbers them, which may be readings, or mixes words and readings.
    """
    if [*map(str, range(len(row)))] == row or [*map(str, range(1, len(row) + 1))] == row:
        violation = f"the columns' numbers, {row[0]} to {row[-1]}"
        raise InputError(path, f"line {line}", violation, "readings, or names in words")
    words = [cell for cell in row if not is_number(cell, comma)]
    readings = [cell for cell in row if cell not in words and not cell.isdecimal() and cell]
    if words and readings:
        raise InputError(path, f"line {line}", repr(words[0]), "numbers alone, or names alone")
    return bool(words)


def _separator(line: str) -> str | None:
    """The separator of cells; None for spaces."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)
