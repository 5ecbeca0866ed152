"""Whether the elements of a MATLAB file are consistent, before scipy reads them.

MAT-File Format, level 5 (MathWorks): elements of a tag, type and bytes, and data up to the next
eighth byte; an array's are its flags, dimensions, name and values, or further arrays. scipy's
reader takes types on trust, and one that does not exist ends the process.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from eitskin import unfolding

HEADER, MARK = 128, slice(126, 128)
ARRAY, COMPRESSED = 14, 15
VALUES = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18))
OF_VALUES = range(4, 16)  # classes of arrays that hold no others
FLAGS = 6
PIECE_BYTES = 1 << 14  # of compressed data, looked at together: 16 MiB unfolded at most
SMALL = 4  # bytes of data that fit into a tag


def is_consistent(path: Path, content: bytes) -> bool:
    """Whether every element has a valid type, is where its type may be, and ends within its
    parent.

    Raises InputError naming `path` where compressed ones unfold to too much.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[MARK])
    size = 0
    try:
        if order is None:
            return False
        for kind, data in _elements(memoryview(content)[HEADER:], order):
            if kind == COMPRESSED:
                unfolded = _unfolded(path, data, size)
                size += len(unfolded)
                if not _arrays(memoryview(unfolded), order):
                    return False
            elif kind != ARRAY or not _array(data, order):
                return False
        return True
    except (struct.error, zlib.error, RecursionError, ValueError):
        return False


def _unfolded(path: Path, data: memoryview, unfolded_before: int) -> bytes:
    """What compressed data unfold to; raises InputError where that, beside `unfolded_before` bytes,
    is too much, and zlib.error for data that do not end."""
    unfolder, pieces, size = zlib.decompressobj(), [], unfolded_before
    for start in range(0, len(data), PIECE_BYTES):
        pieces.append(unfolder.decompress(data[start : start + PIECE_BYTES]))
        size += len(pieces[-1])
        unfolding.refuse(path, size)
    if not unfolder.eof:
        raise zlib.error("compressed data that do not end")
    return b"".join(pieces)


def _arrays(content: memoryview, order: str) -> bool:
    """Whether the content consists of arrays."""
    return all(kind == ARRAY and _array(data, order) for kind, data in _elements(content, order))


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
