"""The one way in which eitskin refuses bad input."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path


class InputError(Exception):
    """Input that cannot be used, told in one line: file, place, what was found, what was
    expected."""

    def __init__(self, file: str | Path, place: str, found: object, expected: str):
        super().__init__(f"{file}: {place}: found {found}, expected {expected}")


@contextlib.contextmanager
def reported(log: str | Path) -> Iterator[None]:
    """Run a workflow job; an InputError becomes one line on stderr and in `log`, and exit code
    1."""
    try:
        yield
    except InputError as error:
        Path(log).parent.mkdir(parents=True, exist_ok=True)
        Path(log).write_text(f"{error}\n")
        print(error, file=sys.stderr)
        sys.exit(1)
