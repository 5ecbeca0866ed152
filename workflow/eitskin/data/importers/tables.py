"""Reading the tables of numbers that other laboratories' files hold."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import scipy.io

from eitskin.errors import InputError


def first_line(path: Path) -> str:
    """The first line of a text file, without a byte-order mark; "" where it is no text file."""
    if not path.is_file():
        return ""
    with path.open("rb") as stream:
        try:
            return stream.readline(1 << 16).decode("utf-8-sig").strip()
        except UnicodeDecodeError:
            return ""


def is_numbers(line: str, count: int | None = None) -> bool:
    """Whether a line holds numbers between commas and nothing else, `count` of them where given."""
    cells = line.split(",")
    try:
        [float(cell) for cell in cells]
    except ValueError:
        return False
    return count is None or len(cells) == count


def numbers(path: Path, lines: Iterable[str], columns: int, separator: str | None) -> np.ndarray:
    """(rows, columns) float64 from lines of numbers; empty lines are passed over.

    Raises InputError naming the row (from 0) for another number of cells or what is no number.
    """
    rows = []
    for line in lines:
        if not line.strip():
            continue
        cells = line.split(separator)
        place = f"row {len(rows)}"
        if len(cells) != columns:
            raise InputError(path, place, f"{len(cells)} numbers", f"{columns}")
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError as error:
            raise InputError(path, place, str(error), "numbers") from error
    return np.array(rows, dtype=float).reshape(-1, columns)


def matlab(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray] | None:
    """The named arrays of numbers of a MATLAB file; None where it is none or lacks one of them."""
    if not path.is_file():
        return None
    with path.open("rb") as stream:
        if stream.read(6) != b"MATLAB":
            return None
    try:
        content = scipy.io.loadmat(path, appendmat=False, variable_names=names)
    except Exception:  # scipy raises whatever a damaged file leads it to
        return None
    arrays = {name: np.asarray(content[name]) for name in names if name in content}
    numeric = [name for name, array in arrays.items() if array.dtype.kind in "biufc"]
    return arrays if numeric == list(names) else None
