"""Tables of cells in text: commas, semicolons, tabs or spaces; decimal points or commas.

UTF-8, with or without a byte-order mark, and UTF-16 with one. Empty lines and lines that begin with
# are skipped. The first line names the columns where it holds words, beside words only whole
numbers. A comma within a number is the decimal point where semicolons, tabs or spaces separate
numbers.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin import text_file
from eitskin.errors import InputError
from eitskin.progress import patient

LOST = ("", "nan", "na", "null", "none")


@dataclass(frozen=True)
class Cells:
    """`rows` of cells of one length, their `lines` in the file, from 1, the columns' `names` if
    any, and whether numbers have a decimal `comma`."""

    path: Path
    names: list[str] | None
    rows: list[list[str]]
    lines: list[int]
    comma: bool

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])

    def words(self, column: int) -> list[str | None]:
        """The cells of a column; None where one is empty."""
        return [row[column] or None for row in self.rows]

    def numbers(self, columns: list[int]) -> np.ndarray:
        """(rows, len(columns)) float64, NaN where a cell is one of LOST.

        Raises InputError naming line and column for what is no finite number.
        """
        table = np.empty((len(self.rows), len(columns)))
        for k, row in enumerate(patient(self.rows, f"reading {self.path.name}")):
            try:
                table[k] = [number(row[column], self.comma) for column in columns]
            except ValueError:
                bad_column = next(
                    column for column in columns if not is_number(row[column], self.comma)
                )
                name = self.names[bad_column] if self.names else bad_column
                place = f"line {self.lines[k]}, column {name}"
                raise InputError(self.path, place, repr(row[bad_column]), "a number") from None
        return table


def read(path: Path) -> Cells:
    """The cells of a text file.

    Raises InputError where it is no text, has no row of cells, rows of different lengths, or
    decimal points beside decimal commas.
    """
    lines = [
        (k + 1, line.strip(" \r"))
        for k, line in enumerate(text_file.read(path).split("\n"))
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise InputError(path, "file", "no line of cells", "a row a frame")
    separator = _separator(lines[-1][1])
    rows = [[cell.strip(' "') for cell in line.split(separator)] for _, line in lines]
    if len(rows[0]) > 1 and all(row[-1] == "" for row in rows):
        rows = [row[:-1] for row in rows]  # a separator at the end of every line
    comma = separator != "," and any("," in cell for cell in rows[-1])
    names = None
    if _is_names(path, rows[0], lines[0][0], comma):
        names, rows, lines = rows[0], rows[1:], lines[1:]
    if not rows:
        raise InputError(path, "file", "no row below the names", "a row a frame")
    width = len(names or rows[0])
    for (number_, line), row in zip(lines, rows, strict=True):
        if len(row) != width:
            raise InputError(path, f"line {number_}", f"{len(row)} cells", f"{width}")
        if comma and "." in line and any(is_number(cell, False) for cell in row if "." in cell):
            expected = "decimal points or decimal commas throughout"
            raise InputError(path, f"line {number_}", "both", expected)
    return Cells(path, names, rows, [number_ for number_, _ in lines], comma)


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


def number(cell: str, comma: bool) -> float:
    """The number in a cell, NaN where it is one of LOST; raises ValueError for other words and for
    infinity."""
    if cell.lower() in LOST:
        return math.nan
    value = float(cell.replace(",", ".") if comma else cell)
    if not math.isfinite(value):
        raise ValueError(cell)
    return value


def is_number(cell: str, comma: bool) -> bool:
    """Whether a cell holds a number or one of LOST."""
    try:
        number(cell, comma)
    except ValueError:
        return False
    return True


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
