"""The numbers of a plain matrix and its labels: text, NumPy's `.npy` and `.npz`.

One column of numbers, or an array of one dimension, is one frame. A column without a name that
counts the rows is left out, columns of words are notes.
"""

import zipfile
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from eitskin import unfolding
from eitskin.data.importers import array_choice, delimited, named_columns
from eitskin.data.importers.matrix_description import (
    LABELS,
    description_path,
    label_in_unit,
    label_of_unit,
    labels_path,
    unit_of,
)
from eitskin.data.recording import NOTE
from eitskin.errors import InputError

WORDS = ("touch", "session")  # labels that need not be numbers
NPY, ZIP = b"\x93NUMPY", b"PK\x03\x04"


@dataclass
class Table:
    """The content of a matrix file: `readings` (F, C), `labels`, (F,) each, floats or words, and
    the `names` of the readings' columns, and what the file itself says of `channels` (each [source,
    sink, plus, minus]) and `unit`, if anything; a `remark` on what was left out or put together."""

    readings: np.ndarray
    labels: dict[str, Any] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    channels: list[list[int]] | None = None
    unit: str | None = None
    remark: str = ""


def read(path: Path, description: dict, array: str | None = None) -> Table:
    """Readings and labels of a matrix and its labels file; raises InputError for a broken one.

    `array` names the one that holds the readings, of several in a file.
    """
    labels = description.get("labels")
    if labels is not None and not isinstance(labels, str | dict):
        raise InputError(
            description_path(path), "key labels", repr(labels), "a file, or columns by name"
        )
    columns = labels if isinstance(labels, dict) else {}
    for name in columns:
        if not is_label(name):
            expected = f"one of {', '.join(LABELS)}, {NOTE}..."
            raise InputError(
                description_path(path), f"key labels.{name}", "an unknown label", expected
            )
    if is_numpy(path):
        table = _from_numpy(path, columns, array)
    elif array is not None:
        raise InputError(path, "setting array", repr(array), "none: the file has one table")
    else:
        table = _from_text(path, columns)
    if table.readings.shape[1] == 1 and not table.labels:
        table.readings = table.readings.T
    if isinstance(labels, str):
        file = labels_path(path, labels)
        if file is None or not file.is_file():
            actual = "a path elsewhere, " if file is None else "no file "
            raise InputError(
                description_path(path), "key labels", f"{actual}{labels!r}", "a file beside it"
            )
        cells = delimited.read(file)
        factors, renamed = _labels_in_units(cells.names or [], table.labels)
        names = [renamed.get(name, name) for name in cells.names or [""]]
        for name in names:
            if not is_label(name) or name in table.labels or names.count(name) > 1:
                expected = f"names among {', '.join(LABELS)}, {NOTE}..., each once"
                raise InputError(file, "line of names", repr(name), expected)
        for column, name in enumerate(names):
            table.labels[name] = _label(cells, name, column, factors.get(name))
    return table


def _from_text(path: Path, columns: dict) -> Table:
    cells = delimited.read(path)
    names = cells.names or []
    places = {name: k for k, name in enumerate(names) if is_label(name)}
    for name in places:
        if names.count(name) > 1:
            raise InputError(path, "line of names", f"{names.count(name)} of {name}", "one")
    for name, column in columns.items():
        column_index = names.index(column) if column in names else column
        places[name] = _column(path, name, column_index, cells.width)
    factors, renamed = _labels_in_units(names, places)
    places |= {label: names.index(name) for name, label in renamed.items()}
    free_columns = [column for column in range(cells.width) if column not in places.values()]
    index = [column for column in free_columns if names and _counts_rows(cells, column)]
    words = [
        column
        for column in free_columns
        if names and names[column] and column not in index and _is_words(cells, column)
    ]
    clock = next(
        (column for column in words if "time_s" not in places and _is_clock(cells, column)), None
    )
    if clock is not None:
        words.remove(clock)
        places["time_s"] = clock
        renamed[names[clock]] = "time_s"
    places |= {f"{NOTE}{names[column]}": column for column in words}
    label_columns = {*index, *places.values()}
    reading_columns = [column for column in free_columns if column not in label_columns]
    labels = {
        name: _label(cells, name, column, factors.get(name)) for name, column in places.items()
    }
    values = cells.numbers(reading_columns)
    reading_names = [names[column] or str(column) for column in reading_columns if names]
    counted = "the column that counts the rows left out" if index else ""
    if named_columns.is_row_a_reading(reading_names):
        frames, channels, unit = named_columns.frames_of_rows(
            path, reading_names, values, cells.lines
        )
        return Table(frames, {}, [], channels, unit, "a row a reading")
    reading_names, values, remark = named_columns.combined(path, reading_names, values)
    by_unit = ", ".join(f"{name} taken for {label}" for name, label in renamed.items())
    remark = "; ".join(filter(None, (cells.remark, by_unit, counted, remark)))
    channels_by_name = named_columns.channels(reading_names)
    return Table(values, labels, reading_names, channels_by_name, unit_of(reading_names), remark)


def _labels_in_units(
    names: list[str], places: Container[str]
) -> tuple[dict[str, float], dict[str, str]]:
    """The factors to the units of labels that columns' names with a unit mean, or their unit alone,
    and those labels by column's name; of labels that have no place yet, and that one name alone
    means."""
    meanings = {
        name: meaning
        for name in names
        if not is_label(name) and (meaning := label_in_unit(name)) and meaning[0] not in places
    }
    labels_by_name = {label for label, _ in meanings.values()}
    for name in names:
        meaning = None if is_label(name) or name in meanings else label_of_unit(name)
        if meaning and meaning[0] not in places and meaning[0] not in labels_by_name:
            meanings[name] = meaning
    labels = [label for label, _ in meanings.values()]
    single = {name: meaning for name, meaning in meanings.items() if labels.count(meaning[0]) == 1}
    return dict(single.values()), {name: label for name, (label, _) in single.items()}


def _counts_rows(cells: delimited.Cells, column: int) -> bool:
    """Whether a column without a name of its own, as pandas writes it, or one of frames' numbers
    counts the rows."""
    assert cells.names is not None
    if cells.names[column].lower() not in ("", "index", "unnamed: 0", *named_columns.FRAMES):
        return False
    numbers = cells.words(column)
    first = numbers[0] or ""
    return first.isdecimal() and numbers == [str(int(first) + k) for k in range(len(numbers))]


def _is_clock(cells: delimited.Cells, column: int) -> bool:
    """Whether a column of words has a date and time in each cell."""
    try:
        return bool([delimited.seconds(word or "") for word in cells.words(column)])
    except ValueError:
        return False


def _is_words(cells: delimited.Cells, column: int) -> bool:
    """Whether no cell of a column is a number."""
    return not any(delimited.is_number(row[column], cells.comma) for row in cells.rows)


def _label(
    cells: delimited.Cells, name: str, column: int, factor: float | None = None
) -> np.ndarray | list:
    """The values of a label; `factor`: what one of the column's unit is in the label's."""
    if name in WORDS or name.startswith(NOTE):
        return cells.words(column)
    if name == "time_s" and _is_words(cells, column):
        return np.array([delimited.seconds(word or "") for word in cells.words(column)])
    numbers = cells.numbers([column])[:, 0]
    if np.iscomplexobj(numbers):
        raise InputError(cells.path, f"label {name}", "complex numbers", "real ones")
    return numbers if factor is None else factor * numbers


def _column(path: Path, name: str, column: object, width: int) -> int:
    if type(column) is not int or not 0 <= column < width:
        expected = f"a column's number, 0 to {width - 1}, or its name"
        raise InputError(description_path(path), f"key labels.{name}", repr(column), expected)
    return column


def _from_numpy(path: Path, columns: dict, choice: str | None) -> Table:
    try:
        if zipfile.is_zipfile(path):
            unfolding.refuse_archive(path)
        with path.open("rb") as stream:
            content = np.load(stream, allow_pickle=False)
            arrays = dict(content) if hasattr(content, "files") else {"": content}
    except InputError:
        raise
    except Exception as error:  # numpy raises whatever a damaged file leads it to
        violation = "a damaged or cut file, or one of objects"
        raise InputError(path, "file", violation, "arrays of numbers, .npy or .npz") from error
    labels = {name: array for name, array in arrays.items() if is_label(name) and array.ndim == 1}
    for name, array in labels.items():
        if array.dtype.kind not in ("biuf" if name in LABELS and name not in WORDS else "biufU"):
            raise InputError(path, f"array {name}", array.dtype, "numbers")
    matrices = {
        name: np.atleast_2d(array)
        for name, array in arrays.items()
        if name not in labels and array.ndim in (1, 2) and array.dtype.kind in "iufc"
    }
    if not matrices:
        found = array_choice.shapes(arrays)
        raise InputError(path, "arrays", found, "one of numbers, frames x channels")
    chosen, remark = array_choice.choice(path, matrices, choice)
    matrix = matrices[chosen]
    for name, column in columns.items():
        labels[name] = matrix[:, _column(path, name, column, matrix.shape[1])].real
    reading_columns = [k for k in range(matrix.shape[1]) if k not in columns.values()]
    return Table(matrix[:, reading_columns], labels, remark=remark)


def is_label(name: object) -> bool:
    """Whether a column of that name holds no readings."""
    return isinstance(name, str) and (name in LABELS or name.startswith(NOTE))


def is_numpy(path: Path) -> bool:
    """Whether a file is one of NumPy's, by its beginning."""
    with path.open("rb") as stream:
        head = stream.read(len(NPY))
    return head.startswith(NPY) or (head.startswith(ZIP) and path.suffix.lower() == ".npz")
