"""Every array of numbers in a MATLAB file, also within its structures.

MATLAB up to version 7.2 (MAT-File Format, MathWorks: `MATLAB 5.0` at the beginning; version 4 has
no such mark) is read by scipy; version 7.3 is HDF5, which is not read here.
"""

from collections.abc import Iterator
from io import BytesIO
from math import prod
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse

from eitskin import unfolding
from eitskin.data.importers import matlab_tags
from eitskin.data.importers.array_choice import shapes
from eitskin.errors import InputError

HDF5 = b"\x89HDF\r\n\x1a\n"
RESAVED = "MATLAB 7.2 or before, save(name, ..., '-v7'), or a plain matrix, .npy or CSV"


def is_matlab(path: Path) -> bool:
    """Whether a file is one of MATLAB, by its beginning or its name, or HDF5."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(len(HDF5))
    return head == HDF5 or head.startswith(b"MATLAB") or path.suffix.lower() == ".mat"


def arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of numbers by name, a structure's fields after a point: `eit.data`, `vi(2).meas`.

    Raises InputError for a file of version 7.3, one that is damaged or cut short, and one that is
    no MATLAB file.
    """
    with path.open("rb") as stream:
        head = stream.read(19)
    if head.startswith((HDF5, b"MATLAB 7.3")):
        raise InputError(path, "file", "MATLAB 7.3 or another HDF5 file", RESAVED)
    fault = "a damaged or cut MATLAB file" if head.startswith(b"MATLAB") else "no MATLAB file"
    data = path.read_bytes()
    try:
        level_5 = scipy.io.matlab.matfile_version(BytesIO(data))[0] == 1
        if level_5 and not matlab_tags.is_consistent(path, data):
            raise InputError(path, "file", fault, RESAVED)
        content = scipy.io.loadmat(BytesIO(data))
    except InputError:
        raise
    except Exception as error:  # scipy raises whatever a damaged file leads it to
        raise InputError(path, "file", fault, RESAVED) from error
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    return {
        name: array
        for key, value in variables.items()
        for name, array in _numeric(path, key, value)
    }


def has_arrays(path: Path, names: tuple[str, ...]) -> bool:
    """Whether a file is one of MATLAB with arrays of numbers of these names."""
    try:
        return is_matlab(path) and arrays(path).keys() >= {*names}
    except InputError:
        return False


def named_arrays(path: Path, names: tuple[str, ...]) -> list[np.ndarray]:
    """The arrays of these names; raises InputError where one is missing, and as `arrays` does."""
    file_arrays = arrays(path)
    if not file_arrays.keys() >= {*names}:
        raise InputError(path, "arrays", shapes(file_arrays), f"{', '.join(names)} among them")
    return [file_arrays[name] for name in names]


def _numeric(path: Path, name: str, value: object) -> Iterator[tuple[str, np.ndarray]]:
    if isinstance(value, scipy.sparse.csc_array | scipy.sparse.csc_matrix):
        unfolding.refuse(path, value.dtype.itemsize * prod(value.shape))
        value = value.toarray()
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names or value.dtype == object:
        for k, element in enumerate(value.ravel()):
            numbered = name if value.size == 1 else f"{name}({k + 1})"
            if value.dtype.names:
                for field in value.dtype.names:
                    yield from _numeric(path, f"{numbered}.{field}", element[field])
            else:
                yield from _numeric(path, numbered, element)
    elif value.dtype.kind in "iufc":
        yield name, value
