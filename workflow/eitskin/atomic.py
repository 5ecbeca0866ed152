"""Files that are there whole or not at all, each with one writer at a time."""

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from eitskin.errors import InputError, refused

PLACE = "file to write"
NEEDED: dict[int | None, str] = {  # of what the operating system refuses
    errno.ENOSPC: "room on the disk",
    errno.EDQUOT: "room within the quota",
    errno.EFBIG: "room for a file of that size",
    errno.EACCES: "a folder that may be written to",
    errno.EPERM: "a folder that may be written to",
    errno.EROFS: "a disk that may be written to",
    errno.ENAMETOOLONG: "a shorter name",
}


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; it replaces `path` on success and vanishes on
    failure. What a killed write left behind is replaced by the next one.

    Raises InputError where `path` is no file's, lies below a file or is being written by another
    process, and, with `path` as its file, for what the operating system refuses: no room, no
    permission.
    """
    path = Path(path)
    with _told(path):
        _refuse_others(path)
        temporary = _beside(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        held = _locked(path, temporary)
        try:
            yield temporary
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        finally:
            os.close(held)


@contextlib.contextmanager
def held_folder(folder: str | Path) -> Iterator[Path]:
    """Make a folder and keep other runs from writing into it; the operating system lets go of it
    where this one is killed.

    Raises InputError where another run holds it, and where it cannot be made.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = os.open(folder, os.O_RDONLY)
    except OSError as error:
        expected = NEEDED.get(error.errno, "a folder's path")
        raise refused(error, folder, "folder to write", expected) from error
    try:
        if not _lock(held):
            expected = "a folder of its own, or one run after the other"
            raise InputError(folder, "folder to write", "another run that writes into it", expected)
        yield folder
    finally:
        os.close(held)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tell what the operating system refuses of `path`; of other files it is left to others."""
    try:
        yield
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(path, PLACE, "a file above it", "a path in a folder") from error
    except OSError as error:
        ours = map(str, (path, _beside(path), *path.parents))
        if error.filename is not None and str(error.filename) not in ours:
            raise
        expected = NEEDED.get(error.errno, "a path that can be written")
        raise refused(error, path, PLACE, expected) from error


def _beside(path: Path) -> Path:
    """Where a file is written before it is whole."""
    return path.with_name(f".{path.name}.part")


def _refuse_others(path: Path) -> None:
    """Refuse what would not be a file's path: a folder, and a device, which would be replaced."""
    if path.is_dir():
        raise InputError(path, PLACE, "a folder", "a file's path")
    if path.exists() and not path.is_file():
        raise InputError(path, PLACE, "a device or a pipe", "a file's path")


def _locked(path: Path, temporary: Path) -> int:
    """The descriptor of the temporary file, which no other process holds."""
    while True:
        held = os.open(temporary, os.O_RDWR | os.O_CREAT, 0o666)
        if not _lock(held):
            os.close(held)
            raise InputError(path, PLACE, "another run that writes it", "one run after the other")
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(held), os.stat(temporary)):
                return held
        os.close(held)  # another run has just finished with it


def _lock(descriptor: int) -> bool:
    """Whether nobody else holds it; a file system without locks has nobody to ask."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True
