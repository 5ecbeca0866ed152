"""Whether the elements of a MATLAB file hold together, before scipy reads them.

MAT-File Format, level 5 (MathWorks): elements of a tag, type and bytes, and data up to the next
eighth byte; an array's are its flags, dimensions, name and values, or further arrays. scipy's
reader takes types on trust, and one that does not exist ends the process.
"""

import struct
import zlib
from collections.abc import Iterator

HEADER, MARK = 128, slice(126, 128)
ARRAY, COMPRESSED = 14, 15
VALUES = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18))
OF_VALUES = range(4, 16)  # classes of arrays that hold no others
FLAGS = 6
SMALL = 4  # bytes of data that fit into a tag


def hold_together(content: bytes) -> bool:
    """Whether every element is of a type that there is, where it may stand, and ends within what
    holds it."""
    order = {b"IM": "<", b"MI": ">"}.get(content[MARK])
    try:
        return order is not None and _arrays(memoryview(content)[HEADER:], order)
    except (struct.error, zlib.error, RecursionError, ValueError):
        return False


def _arrays(content: memoryview, order: str) -> bool:
    """Whether content is arrays, compressed or not."""
    for kind, data in _elements(content, order):
        if kind == COMPRESSED:
            if not _arrays(memoryview(zlib.decompress(data)), order):
                return False
        elif kind != ARRAY or not _array(data, order):
            return False
    return True


def _array(content: memoryview, order: str) -> bool:
    """Whether an array's flags come first, and then what an array of its class may hold."""
    elements = list(_elements(content, order))
    if not elements:  # what MATLAB writes for an empty one in a cell
        return True
    kind, flags = elements[0]
    if kind != FLAGS or len(flags) < 8:
        return False
    of_values = struct.unpack(f"{order}I", flags[:4])[0] & 0xFF in OF_VALUES
    for kind, data in elements[1:]:
        if kind == ARRAY and not of_values:
            if not _array(data, order):
                return False
        elif kind not in VALUES:
            return False
    return True


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and data of elements, one after the other; raises ValueError where one is cut off."""
    at = 0
    while at < len(content):
        kind, size = struct.unpack(f"{order}II", content[at : at + 8])
        start, after = at + 8, at + 8 + size + (-size % 8 if kind != COMPRESSED else 0)
        if kind >> 16:  # a small one, in its tag
            kind, size, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > SMALL:
                raise ValueError(size)
        if start + size > len(content):
            raise ValueError(size)
        yield kind, content[start : start + size]
        at = after
