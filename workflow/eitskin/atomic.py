"""Files that are there whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from eitskin.errors import InputError


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; it replaces `path` on success and vanishes on
    failure.

    What a killed write left behind is replaced by the next one, so that a file has one writer at a
    time. Raises InputError where `path` is a folder or lies below a file.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(path, "file to write", "a folder", "a file's path")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(path, "file to write", "a file above it", "a path in a folder") from error
    temporary = path.with_name(f".{path.name}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
