"""Readers of the tables of numbers in other laboratories' files."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.text_file import UTF_16

HEAD = 1 << 16  # bytes: longer than the first line of any format


def first_line(path: Path) -> str:
    """The first line of a text file, without a byte-order mark; "" where it is no text file."""
    if not path.is_file():
        return ""
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    wide = head.startswith(UTF_16)
    try:
        text = head.decode("utf-16", "ignore") if wide else head.split(b"\n")[0].decode("utf-8-sig")
    except UnicodeDecodeError:
        return ""
    return text.partition("\n")[0].strip()


def separator_of(line: str) -> str:
    """The separator of a line's cells: a semicolon or tab where it has one, else a comma."""
    return next((mark for mark in ";\t" if mark in line), ",")


def cells(line: str) -> list[str]:
    """The cells of a line."""
    return [cell.strip(' "') for cell in line.split(separator_of(line))]


def is_numbers(line: str, count: int) -> bool:
    """Whether a line holds `count` cells of numbers and nothing else."""
    line_cells = cells(line)
    return len(line_cells) == count and all(map(_is_number, line_cells))


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"[-+]?(\d+[.,]?\d*|[.,]\d+)(e[-+]?\d+)?|nan", cell.lower()) is not None


def numbers(path: Path, lines: Sequence[str], columns: int, head: int) -> np.ndarray:
    """(rows, columns) float64 of numbers between spaces, of a file's lines after the first `head`.

    Empty lines are skipped. Raises InputError naming the line for another number of cells and for
    what is no number.
    """
    rows: list[list[float]] = []
    for k, line in enumerate(lines[head:], head + 1):
        line_cells = line.split()
        if not line_cells:
            continue
        place = f"line {k}"
        if len(line_cells) != columns:
            raise InputError(path, place, f"{len(line_cells)} numbers", f"{columns}")
        try:
            rows.append([float(cell) for cell in line_cells])
        except ValueError as error:
            raise InputError(path, place, str(error), "numbers") from error
    return np.array(rows, dtype=float).reshape(-1, columns)
