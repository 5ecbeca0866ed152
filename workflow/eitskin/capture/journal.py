"""The journal of a capture: one JSON object a line, appended and on the disk before anything else
happens, so that a kill or a loss of power costs the line that was being written at most."""

import contextlib
import fcntl
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from eitskin.errors import InputError


@dataclass(frozen=True)
class Journal:
    """The records of a journal in order, and the length (bytes) of its whole lines."""

    records: list[dict]
    length: int

    def first_unfinished(self, contacts: int) -> int:
        """The first contact whose `end` is not there; `contacts` where all are."""
        ended = {record["contact"] for record in self.records if record["kind"] == "end"}
        return next((number for number in range(contacts) if number not in ended), contacts)

    def attempts(self, contact: int) -> int:
        """How many times a contact was begun."""
        begun = [r for r in self.records if r["kind"] == "begin" and r["contact"] == contact]
        return len(begun)


def read(path: str | Path, kind: str = "capture") -> Journal:
    """The records of a journal whose first is of `kind`. A last line that was cut short is left
    out.

    Raises InputError for a file that is none, a broken line with others behind it, and a record
    that is missing.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(path, "file", error.strerror, f"a {kind}'s journal") from error
    records: list[dict] = []
    length = 0
    lines = data.split(b"\n")
    if lines[-1] == b"":
        lines.pop()
    for number, line in enumerate(lines, start=1):
        record = _record(line) if length + len(line) < len(data) else None
        if record is None:
            if number == len(lines):
                break
            found = f"{line[:40]!r}"
            raise InputError(path, f"line {number}", found, "a whole record before others")
        if record["number"] != len(records):
            found = f"record {record['number']}"
            raise InputError(path, f"line {number}", found, f"record {len(records)}")
        records.append(record)
        length += len(line) + 1
    if not records or records[0].get("kind") != kind:
        raise InputError(path, "line 1", f"no record of a {kind}", f"a {kind}'s journal")
    return Journal(records, length)


def _record(line: bytes) -> dict | None:
    """The record of a line, None where it is none."""
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or type(record.get("number")) is not int:
        return None
    return record if isinstance(record.get("kind"), str) else None


def begin(path: str | Path, head: dict) -> None:
    """Make a journal of one record, there whole or not at all; raises InputError where a file is
    there already."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as stream:
        stream.write(_text(0, head))
        stream.flush()
        os.fsync(stream.fileno())
    try:
        os.link(part, path)
    except FileExistsError as error:
        expected = "none; `eitskin rig resume` goes on with one"
        raise InputError(path, "file", "a journal", expected) from error
    finally:
        part.unlink()
    folder = os.open(path.parent, os.O_RDONLY)
    os.fsync(folder)
    os.close(folder)


def taken_away(path: str | Path, kind: str = "capture") -> bool:
    """Whether a journal is there that holds nothing but its first record, as one that was killed
    before it began leaves it; then it is taken away. Raises as `read`, and InputError where it is
    being written."""
    if not Path(path).exists():
        return False
    found = read(path, kind)
    if len(found.records) > 1:
        return False
    writer = Writer(path, found)
    Path(path).unlink()
    writer.close()
    return True


def _text(number: int, record: dict) -> str:
    return json.dumps({"number": number, **record}, allow_nan=False) + "\n"


def _lock(file: int, path: str | Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise InputError(path, "file", "another capture's lock", "one at a time") from error


class Writer:
    """Appends to a journal; nobody else can while it is open."""

    def __init__(self, path: str | Path, found: Journal):
        """Go on with the journal that `found` was read from: what was cut short at its end is taken
        off. Raises InputError where it is being written by another, or was since it was read.
        """
        self._file = os.open(path, os.O_RDWR | os.O_APPEND)
        try:
            _lock(self._file, path)
            if read(path, found.records[0]["kind"]) != found:
                written = "what another capture has just written"
                raise InputError(path, "file", written, "one at a time")
            self._number, self._length = len(found.records), found.length
            os.ftruncate(self._file, self._length)
            os.fsync(self._file)
        except BaseException:
            os.close(self._file)
            raise

    def append(self, *records: dict) -> None:
        """Write records, in order, and return once they are on the disk; raises OSError where they
        cannot be. Whatever raises, all of them stand in the journal or none."""
        os.ftruncate(self._file, self._length)  # what an earlier append could not take off
        numbered = enumerate(records, start=self._number)
        text = "".join(_text(number, record) for number, record in numbered).encode()
        length = self._length + len(text)
        try:
            while text:
                text = text[os.write(self._file, text) :]
            os.fsync(self._file)
        finally:
            if os.fstat(self._file).st_size == length:
                self._number, self._length = self._number + len(records), length
            else:
                with contextlib.suppress(OSError):
                    os.ftruncate(self._file, self._length)

    def close(self) -> None:
        """Let go of the journal."""
        os.close(self._file)


def finished_frames(records: Iterable[dict]) -> list[dict]:
    """The frames of contacts that were finished, of each contact's last attempt alone, in order."""
    records = list(records)
    attempt = {r["contact"]: r["attempt"] for r in records if r["kind"] == "end"}
    frames = [record for record in records if record["kind"] == "frame"]
    return [frame for frame in frames if attempt.get(frame["contact"]) == frame["attempt"]]
