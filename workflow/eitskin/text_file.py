"""Text of files from other sources."""

import codecs
from pathlib import Path

from eitskin.errors import InputError

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
ENCODINGS = "UTF-8 (in Excel: CSV UTF-8), or UTF-16 with a byte-order mark"
WINDOWS = "cp1252"


def read(path: str | Path) -> str:
    """The text of a file, UTF-8 with or without a byte-order mark or UTF-16 with one, lines ending
    with \\n.

    Raises OSError where it cannot be read, InputError for bytes that are no such text.
    """
    content = Path(path).read_bytes()
    if content.startswith(UTF_16):
        try:
            text = content.decode("utf-16")
        except UnicodeDecodeError as error:
            place = f"byte {error.start}"
            raise InputError(path, place, "the end of UTF-16 cut off", ENCODINGS) from error
    else:
        text = utf_8(path, content, ENCODINGS)
    if "\0" in text:
        actual = "bytes of 0, as UTF-16 without a byte-order mark has"
        raise InputError(path, "file", actual, ENCODINGS)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_table(path: str | Path) -> str:
    """As `read`, and of a table without other bytes in its numbers also Windows-1252, in which
    spreadsheets write the line of names."""
    content = Path(path).read_bytes()
    lines = content.splitlines(keepends=True)
    names = next((k for k, line in enumerate(lines) if line.strip() and line[:1] != b"#"), 0)
    try:
        return read(path)
    except InputError:
        if b"\0" in content or not b"".join(lines[names + 1 :]).isascii():
            raise
    return content.decode(WINDOWS, errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def utf_8(path: str | Path, content: bytes, expected: str = "UTF-8") -> str:
    """Bytes of a file as text. Raises InputError with the line of the first byte that is not
    UTF-8."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        position = (
            error.start + len(content) - len(error.object)
        )  # a byte-order mark is counted as well
        line, actual = (
            content.count(b"\n", 0, position) + 1,
            f"byte 0x{content[position]:02x}, no UTF-8",
        )
        if content.startswith(UTF_16):
            line, actual = 1, "UTF-16"
        raise InputError(path, f"line {line}", actual, expected) from error
