"""Excel workbooks (`.xlsx`): the first sheet as lines of cells, by openpyxl where it is there."""

import zipfile
from importlib import import_module
from pathlib import Path

from eitskin.errors import InputError

ZIP = b"PK\x03\x04"


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
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        rows = list(book.worksheets[0].iter_rows(values_only=True))
    except Exception as error:  # openpyxl raises whatever a damaged file leads it to
        expected = "a whole one, or the sheet saved as CSV"
        raise InputError(path, "file", "a damaged Excel workbook", expected) from error
    return [
        (k, "\t".join("" if cell is None else str(cell) for cell in row))
        for k, row in enumerate(rows, 1)
        if any(cell is not None for cell in row)
    ]
