"""The journal of a capture: one JSON object a line, synced to disk before the capture goes on, so
that a kill or a loss of power costs the line being written at most."""

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
    """The records of a journal in order, and the length of its complete lines in bytes."""

    records: list[dict]
    length: int

    def first_unfinished(self, contacts: int) -> int:
        """The first of `contacts` contacts without a record `end`, else `contacts`."""
        finished_contacts = {
            record["contact"] for record in self.records if record["kind"] == "end"
        }
        return next(
            (number for number in range(contacts) if number not in finished_contacts), contacts
        )

    def attempts(self, contact: int) -> int:
        """How many times a contact was begun."""
        begin_records = [
            r for r in self.records if r["kind"] == "begin" and r["contact"] == contact
        ]
        return len(begin_records)


def read(path: str | Path, kind: str = "capture") -> Journal:
    """Read a journal whose first record is of `kind`, without a last line that was cut short.

    Raises InputError for another file, a broken line before the last, and a missing record.
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
            violation = f"{line[:40]!r}"
            raise InputError(path, f"line {number}", violation, "a whole record before others")
        if record["number"] != len(records):
            violation = f"record {record['number']}"
            raise InputError(path, f"line {number}", violation, f"record {len(records)}")
        records.append(record)
        length += len(line) + 1
    if not records or records[0].get("kind") != kind:
        raise InputError(path, "line 1", f"no record of a {kind}", f"a {kind}'s journal")
    return Journal(records, length)


def _record(line: bytes) -> dict | None:
    """The record in a line; None where it holds none."""
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or type(record.get("number")) is not int:
        return None
    return record if isinstance(record.get("kind"), str) else None


def begin(path: str | Path, header: dict) -> None:
    """Create a journal of one record atomically; raises InputError where the file exists."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial_path = path.with_name(f".{path.name}.part")
    with partial_path.open("w", encoding="utf-8") as stream:
        stream.write(_record_line(0, header))
        stream.flush()
        os.fsync(stream.fileno())
    try:
        os.link(partial_path, path)
    except FileExistsError as error:
        expected = "none; `eitskin rig resume` goes on with one"
        raise InputError(path, "file", "a journal", expected) from error
    finally:
        partial_path.unlink()
    folder_descriptor = os.open(path.parent, os.O_RDONLY)
    os.fsync(folder_descriptor)
    os.close(folder_descriptor)


def remove_if_empty(path: str | Path, kind: str = "capture") -> bool:
    """Delete a journal that holds its first record alone, as a kill before any frame leaves it.

    Returns whether it was deleted. Raises InputError as `read` does, and where another process
    writes it.
    """
    if not Path(path).exists():
        return False
    journal = read(path, kind)
    if len(journal.records) > 1:
        return False
    writer = Writer(path, journal)
    Path(path).unlink()
    writer.close()
    return True


def _record_line(number: int, record: dict) -> str:
    return json.dumps({"number": number, **record}, allow_nan=False) + "\n"


def _lock(file_descriptor: int, path: str | Path) -> None:
    try:
        fcntl.flock(file_descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise InputError(path, "file", "another capture's lock", "one at a time") from error


class Writer:
    """Appends to a journal and locks it against other writers."""

    def __init__(self, path: str | Path, journal: Journal):
        """Open the file that `journal` was read from and truncate an incomplete last line.

        Raises InputError where another process writes it, or has written since it was read.
        """
        self._file = os.open(path, os.O_RDWR | os.O_APPEND)
        try:
            _lock(self._file, path)
            if read(path, journal.records[0]["kind"]) != journal:
                violation = "what another capture has just written"
                raise InputError(path, "file", violation, "one at a time")
            self._number, self._length = len(journal.records), journal.length
            os.ftruncate(self._file, self._length)
            os.fsync(self._file)
        except BaseException:
            os.close(self._file)
            raise

    def append(self, *records: dict) -> None:
        """Append records and sync them to disk: all of them, or none where it raises OSError."""
        os.ftruncate(self._file, self._length)  # what an earlier append could not take off
        numbered_records = enumerate(records, start=self._number)
        pending_bytes = "".join(
            _record_line(number, record) for number, record in numbered_records
        ).encode()
        length = self._length + len(pending_bytes)
        try:
            while pending_bytes:
                pending_bytes = pending_bytes[os.write(self._file, pending_bytes) :]
            os.fsync(self._file)
        finally:
            if os.fstat(self._file).st_size == length:
                self._number, self._length = self._number + len(records), length
            else:
                with contextlib.suppress(OSError):
                    os.ftruncate(self._file, self._length)

    def close(self) -> None:
        """Close the journal and release its lock."""
        os.close(self._file)


def finished_frames(records: Iterable[dict]) -> list[dict]:
    """The frames of finished contacts in order, of each contact's last attempt alone."""
    records = list(records)
    last_attempt = {r["contact"]: r["attempt"] for r in records if r["kind"] == "end"}
    frames = [record for record in records if record["kind"] == "frame"]
    return [frame for frame in frames if last_attempt.get(frame["contact"]) == frame["attempt"]]
