"""Which of several arrays in a file holds the untouched frames: the named one, or the reference."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from eitskin.errors import InputError

REFERENCE = re.compile(
    r"v?h\d*|v?_?ref.*|v?_?ho?mg.*|v?_?homog.*|empty.*|untouched.*|base.*|background.*|bg\d*"
)
MAX_SHOWN = 8


def choice(
    path: Path, arrays: dict[str, np.ndarray], array: str | None, unfit: Iterable[str] = ()
) -> tuple[str, str]:
    """The name of the array to read and a remark on those left out.

    It is `array`, or the only one, or the only one whose name says that it is the reference: `vh`,
    `v_homg`, `background`, ... Raises InputError where none is, with the names to choose among;
    `unfit` are names of arrays that cannot be readings.
    """
    if array is not None and array not in arrays:
        actual = f"{array!r}, whose shape no readings have" if array in unfit else repr(array)
        raise InputError(path, "array", actual, f"one of {shapes(arrays)}")
    references = [
        name for name in arrays if any(map(REFERENCE.fullmatch, re.split(r"[._ ]", name.lower())))
    ]
    names = [array] if array is not None else list(arrays) if len(arrays) == 1 else references
    if len(names) != 1:
        shape_text = shapes({name: arrays[name] for name in names or arrays})
        expected = (
            "one whose name says that it is the reference (vh, v_homg, reference), or --array NAME"
        )
        raise InputError(path, "arrays", shape_text, expected)
    left_out = ", ".join(name for name in arrays if name != names[0])
    return names[0], f"{left_out} left out, objects at unknown places" if left_out else ""


def shapes(arrays: dict[str, np.ndarray]) -> str:
    """Names and shapes of at most MAX_SHOWN arrays: `vh (208, 1), vi (208, 5)`."""
    texts = [f"{name or 'one'} {array.shape}" for name, array in arrays.items()]
    ellipsis = ", ..." if len(texts) > MAX_SHOWN else ""
    return ", ".join(texts[:MAX_SHOWN]) + ellipsis or "no array of numbers"
