"""The one way in which eitskin refuses bad input."""

import contextlib
import os
import sys
import traceback
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

# What code that is only half written raises where it is imported.
UNFINISHED = (AttributeError, ImportError, LookupError, NameError, TypeError, ValueError)
UNNAMED = ("recording", "skin", "states", "touch", "protocol", "patch", "effects")


class InputError(Exception):
    """Input that cannot be used, told in one line: file, place, what was found, what was
    expected.

    Notes (`add_note`) say more; they go to a job's log, not to the line.
    """

    def __init__(self, file: str | Path, place: str, found: object, expected: str):
        super().__init__(f"{file}: {place}: found {found}, expected {expected}")
        self.file, self.place, self.found, self.expected = file, place, found, expected

    def __reduce__(self) -> tuple:
        """As another process is told it."""
        told = self.file, self.place, self.found, self.expected
        return type(self), told, vars(self)


def refused(
    error: OSError,
    file: str | Path | None = None,
    place: str = "file",
    expected: str = "one that can be read and written",
) -> InputError:
    """What the operating system refuses, as an InputError of `file`, else of the one it names."""
    if error.errno is None:
        reason = str(error).partition("\n")[0] or "an unknown error"
    else:
        reason = os.strerror(error.errno)
    return InputError(file or error.filename or "eitskin", place, reason, expected)


def imported(module: str) -> ModuleType:
    """A module that somebody may have added to the house, by its whole name.

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
        found = f"{type(error).__name__}: {error}".partition("\n")[0]
        place = _line(lines[-1] if lines else None)
        raise InputError(file, place, found, "code that can be imported") from error


def _line(number: int | None) -> str:
    return f"line {number}" if number else "file"


@contextlib.contextmanager
def named(file: str | Path) -> Iterator[None]:
    """Where code that was given no file refuses a recording, or what it says of the skin, name its
    file."""
    try:
        yield
    except InputError as error:
        if error.file not in UNNAMED:
            raise
        place = error.place if error.file == "recording" else f"{error.file}, {error.place}"
        raise InputError(file, place, error.found, error.expected) from error


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
