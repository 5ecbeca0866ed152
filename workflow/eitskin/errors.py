"""The one way in which eitskin refuses bad input."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path


class InputError(Exception):
    """Input that cannot be used, told in one line: file, place, what was found, what was
    expected.

    Notes (`add_note`) say more; they go to a job's log, not to the line.
    """

    def __init__(self, file: str | Path, place: str, found: object, expected: str):
        super().__init__(f"{file}: {place}: found {found}, expected {expected}")
        self.place, self.found, self.expected = place, found, expected


@contextlib.contextmanager
def reported(log: str | Path) -> Iterator[None]:
    """Run a workflow job; an InputError becomes one line on stderr, the same line and its notes
    in `log`, and exit code 1."""
    try:
        yield
    except InputError as error:
        Path(log).parent.mkdir(parents=True, exist_ok=True)
        notes = "".join(getattr(error, "__notes__", []))
        Path(log).write_text(f"{error}\n{notes}", encoding="utf-8")
        print(error, file=sys.stderr)
        sys.exit(1)
