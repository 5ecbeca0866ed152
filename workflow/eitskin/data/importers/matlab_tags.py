"""Whether the elements of a MATLAB file are consistent, before scipy reads them.

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


def is_consistent(content: bytes) -> bool:
    """Whether every element has a valid type, is where its type may be, and ends within its
    parent."""
    order = {b"IM": "<", b"MI": ">"}.get(content[MARK])
    try:
        return order is not None and _arrays(memoryview(content)[HEADER:], order)
    except (struct.error, zlib.error, RecursionError, ValueError):
        return False


def _arrays(content: memoryview, order: str) -> bool:
    """Whether the content consists of arrays, compressed or not."""
    for kind, data in _elements(content, order):
        if kind == COMPRESSED:
            if not _arrays(memoryview(zlib.decompress(data)), order):
                return False
        elif kind != ARRAY or not _array(data, order):
            return False
    return True


def _array(content: memoryview, order: str) -> bool:
    """Whether an array begins with its flags, followed by elements allowed for its class."""
    elements = list(_elements(content, order))
    if not elements:  # MATLAB writes an empty array in a cell so
        return True
    kind, flags = elements[0]
    if kind != FLAGS or len(flags) < 8:
        return False
    holds_values = struct.unpack(f"{order}I", flags[:4])[0] & 0xFF in OF_VALUES
    for kind, data in elements[1:]:
        if kind == ARRAY and not holds_values:
            if not _array(data, order):
                return False
        elif kind not in VALUES:
            return False
    return True


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and data of the elements in order; raises ValueError where one is cut off."""
    offset = 0
    while offset < len(content):
        kind, size = struct.unpack(f"{order}II", content[offset : offset + 8])
        start, next_offset = (
            offset + 8,
            offset + 8 + size + (-size % 8 if kind != COMPRESSED else 0),
        )
        if kind >> 16:  # a small one, in its tag
            kind, size, start, next_offset = kind & 0xFFFF, kind >> 16, offset + 4, offset + 8
            if size > SMALL:
                raise ValueError(size)
        if start + size > len(content):
            raise ValueError(size)
        yield kind, content[start : start + size]
        offset = next_offset
