"""Excel workbooks (`.xlsx`): the first sheet as lines of cells, by openpyxl where it is there."""

import zipfile
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path

from eitskin import unfolding
from eitskin.errors import InputError

ZIP = b"PK\x03\x04"
CELL_BYTES = 8  # of a reference to its value


def is_workbook(path: Path) -> bool:
    """Whether a file is a workbook of Excel, by its beginning and its parts."""
    with path.open("rb") as stream:
        if stream.read(len(ZIP)) != ZIP:
            return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.startswith("xl/") for name in archive.namelist())
    except (zipfile.BadZipFile, OSError):
        return False


def lines(path: Path) -> list[tuple[int, str]]:
    """Numbers, from 1, and cells, separated by tabs, of the first sheet's rows that hold any.

    Raises InputError for a damaged workbook, and where openpyxl is not installed.
    """
    try:
        openpyxl = import_module("openpyxl")
    except ImportError as error:
        expected = "the sheet saved as CSV; or openpyxl installed, which reads it"
        raise InputError(path, "format", "an Excel workbook", expected) from error
    try:
        unfolding.refuse_archive(path)
        sheet = openpyxl.load_workbook(path, read_only=True, data_only=True).worksheets[0]
        sheet.reset_dimensions()  # as stated, they would be filled up with empty cells
        rows = list(_measured(path, sheet.iter_rows(values_only=True)))
    except InputError:
        raise
    except Exception as error:  # openpyxl raises whatever a damaged file leads it to
        expected = "a whole one, or the sheet saved as CSV"
        raise InputError(path, "file", "a damaged Excel workbook", expected) from error
    width = max(map(len, rows), default=0)
    rows = [(*row, *[None] * (width - len(row))) for row in rows]
    return [
        (k, "\t".join("" if cell is None else str(cell) for cell in row))
        for k, row in enumerate(rows, 1)
        if any(cell is not None for cell in row)
    ]


def _measured(path: Path, rows: Iterable[tuple]) -> Iterator[tuple]:
    """The rows, as long as `unfolding` lets their cells be."""
    size = 0
    for row in rows:
        size += CELL_BYTES * len(row)
        unfolding.refuse(path, size)
        yield row
