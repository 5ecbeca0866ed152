"""Tables of cells in text: commas, semicolons, tabs or spaces; decimal points or commas.

UTF-8, with or without a byte-order mark, and UTF-16 with one. Empty lines and lines that begin with
# are passed over. The first of the others names the columns where it holds words, beside words only
whole numbers. A comma within a number stands for the decimal point where semicolons, tabs or spaces
stand between numbers.
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
    """`rows` of cells, all of one length, `lines` their numbers in the file, from 1; `names` of the
    columns, where the file has them; whether numbers have a decimal `comma`."""

    path: Path
    names: list[str] | None
    rows: list[list[str]]
    lines: list[int]
    comma: bool

    @property
    def width(self) -> int:
        """Columns."""
        return len(self.rows[0])

    def words(self, column: int) -> list[str | None]:
        """The cells of a column; None where one is empty."""
        return [row[column] or None for row in self.rows]

    def numbers(self, columns: list[int]) -> np.ndarray:
        """(rows, len(columns)) float64, NaN where a cell is empty or says so.

        Raises InputError naming line and column for what is no finite number.
        """
        table = np.empty((len(self.rows), len(columns)))
        for k, row in enumerate(patient(self.rows, f"reading {self.path.name}")):
            try:
                table[k] = [number(row[column], self.comma) for column in columns]
            except ValueError:
                wrong = next(column for column in columns if not is_number(row[column], self.comma))
                name = self.names[wrong] if self.names else wrong
                place = f"line {self.lines[k]}, column {name}"
                raise InputError(self.path, place, repr(row[wrong]), "a number") from None
        return table


def read(path: Path) -> Cells:
    """The cells of a text file; raises InputError where it is no text, has no row of cells, rows of
    several lengths, or decimal points beside decimal commas.
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
    found = read(path)
    if found.names:
        raise InputError(path, "line 1", repr(", ".join(found.names)[:60]), "numbers alone")
    if found.width != columns:
        place = f"line {found.lines[0]}"
        raise InputError(path, place, f"{found.width} cells", f"{columns}")
    return found.numbers(list(range(columns)))


def number(cell: str, comma: bool) -> float:
    """The number in a cell, NaN where it was lost; raises ValueError for none and for infinity."""
    if cell.lower() in LOST:
        return math.nan
    value = float(cell.replace(",", ".") if comma else cell)
    if not math.isfinite(value):
        raise ValueError(cell)
    return value


def is_number(cell: str, comma: bool) -> bool:
    """Whether a cell holds a number, or nothing."""
    try:
        number(cell, comma)
    except ValueError:
        return False
    return True


def _is_names(path: Path, row: list[str], line: int, comma: bool) -> bool:
    """Whether the first row names the columns; raises InputError where it counts them, which cannot
    be told from readings, or holds words among readings."""
    if [*map(str, range(len(row)))] == row or [*map(str, range(1, len(row) + 1))] == row:
        found = f"the columns' numbers, {row[0]} to {row[-1]}"
        raise InputError(path, f"line {line}", found, "readings, or names in words")
    words = [cell for cell in row if not is_number(cell, comma)]
    readings = [cell for cell in row if cell not in words and not cell.isdecimal() and cell]
    if words and readings:
        raise InputError(path, f"line {line}", repr(words[0]), "numbers alone, or names alone")
    return bool(words)


def _separator(line: str) -> str | None:
    """None: spaces."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)
