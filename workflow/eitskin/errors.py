"""InputError, the one way in which eitskin refuses bad input."""

import contextlib
import os
import re
import sys
import traceback
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

# Raised on the import of unfinished code.
UNFINISHED = (AttributeError, ImportError, LookupError, NameError, TypeError, ValueError)
# Values of InputError.file that are no file: code that was given none uses them.
UNNAMED = ("recording", "skin", "states", "touch", "protocol", "patch", "effects")
QUOTED, EXPLAINED = 300, 1500  # characters of a place or an actual value, and of an expected one
# What a terminal obeys or reorders, and what no encoding has: control characters, line and
# paragraph ends, marks of direction, halves of surrogate pairs.
UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


class InputError(Exception):
    """Unusable input, reported in one line: file, place, the actual and the expected value.

    What comes from a file may be of any length and hold anything: it is quoted in QUOTED
    characters, and without what a terminal would obey. Notes (`add_note`) give details; they
    appear in a job's log, not in the line.
    """

    def __init__(self, file: str | Path, place: str, actual: object, expected: str):
        self.file, self.place = file, _quoted(place, QUOTED)
        self.actual, self.expected = _quoted(actual, QUOTED), _quoted(expected, EXPLAINED)
        line = f"{self.place}: found {self.actual}, expected {self.expected}"
        super().__init__(f"{printable(str(file))}: {line}")

    def __reduce__(self) -> tuple:
        """Pickled by its four arguments and its notes."""
        arguments = self.file, self.place, self.actual, self.expected
        return type(self), arguments, vars(self)


def printable(text: str) -> str:
    """The text with UNPRINTABLE characters as Python writes them: \\x1b, \\n."""
    return UNPRINTABLE.sub(lambda mark: mark[0].encode("unicode_escape").decode(), text)


def _quoted(value: object, limit: int) -> str:
    """A value as printable text; of one of more than `limit` characters the beginning, and how
    many it has."""
    text = printable(str(value))
    return text if len(text) <= limit else f"{text[: limit - 30]}… ({len(text)} characters)"


def refused(
    error: OSError,
    file: str | Path | None = None,
    place: str = "file",
    expected: str = "one that can be read and written",
) -> InputError:
    """A refusal of the operating system as an InputError of `file`, by default the one it names."""
    if error.errno is None:
        reason = str(error).partition("\n")[0] or "an unknown error"
    else:
        reason = os.strerror(error.errno)
    return InputError(file or error.filename or "eitskin", place, reason, expected)


def imported(module: str) -> ModuleType:
    """Import a module, possibly one that a user added, by its full name.

    Raises InputError, with file and line, where it cannot be imported.
    """
    try:
        return import_module(module)
    except SyntaxError as error:
        raise InputError(
            error.filename or module, _line(error.lineno), error.msg, "Python"
        ) from error
    except UNFINISHED as error:
        spec = find_spec(module)
        file = spec.origin if spec and spec.origin else module
        calls = traceback.extract_tb(error.__traceback__)
        lines = [call.lineno for call in calls if call.filename == file]
        actual = f"{type(error).__name__}: {error}".partition("\n")[0]
        place = _line(lines[-1] if lines else None)
        raise InputError(file, place, actual, "code that can be imported") from error


def _line(number: int | None) -> str:
    return f"line {number}" if number else "file"


@contextlib.contextmanager
def named(file: str | Path) -> Iterator[None]:
    """Put `file` into refusals of a recording or its skin by code that was given no file."""
    try:
        yield
    except InputError as error:
        if error.file not in UNNAMED:
            raise
        place = error.place if error.file == "recording" else f"{error.file}, {error.place}"
        raise InputError(file, place, error.actual, error.expected) from error


@contextlib.contextmanager
def reported(log: str | Path) -> Iterator[None]:
    """Run a workflow job; an InputError or OSError becomes one line on stderr, the same line and
    its notes in `log`, and exit code 1. Ctrl-C is one line in `log`, and exit code 130."""
    try:
        yield
    except KeyboardInterrupt:
        Path(log).parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(OSError):
            Path(log).write_text("interrupted: the same command goes on\n", encoding="utf-8")
        sys.exit(130)
    except (InputError, OSError) as error:
        line = error if isinstance(error, InputError) else refused(error)
        Path(log).parent.mkdir(parents=True, exist_ok=True)
        notes = "".join(getattr(error, "__notes__", []))
        with contextlib.suppress(OSError):  # no room on the disk for the log either
            Path(log).write_text(f"{line}\n{notes}", encoding="utf-8")
        print(line, file=sys.stderr)
        sys.exit(1)
