"""Files that are written whole or not at all, each by one writer at a time."""

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from eitskin.errors import InputError, refused

PLACE = "file to write"
EXPECTED_BY_ERRNO: dict[int | None, str] = {
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
    """Yield a temporary path beside `path`; it replaces `path` on success and vanishes on failure.
    The remains of a killed write are replaced by the next one.

    Raises InputError where `path` is a folder, a device or a pipe, lies below a file or is being
    written by another process, and, with `path` as its file, where the operating system refuses it:
    no room, no permission.
    """
    path = Path(path)
    with _refusals_named(path):
        _refuse_others(path)
        temporary = _temporary_path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _locked_descriptor(path, temporary)
        try:
            yield temporary
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        finally:
            os.close(descriptor)


@contextlib.contextmanager
def held_folder(folder: str | Path) -> Iterator[Path]:
    """Create a folder and lock it against other runs; the lock ends with this process.

    Raises InputError where another run holds it, and where it cannot be created.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        expected = EXPECTED_BY_ERRNO.get(error.errno, "a folder's path")
        raise refused(error, folder, "folder to write", expected) from error
    try:
        if not _has_lock(descriptor):
            expected = "a folder of its own, or one run after the other"
            raise InputError(folder, "folder to write", "another run that writes into it", expected)
        yield folder
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _refusals_named(path: Path) -> Iterator[None]:
    """Turn refusals of the operating system that concern `path` into InputError; others pass."""
    try:
        yield
    except (FileExistsError, NotADirectoryError) as error:
        raise InputError(path, PLACE, "a file above it", "a path in a folder") from error
    except OSError as error:
        known_paths = map(str, (path, _temporary_path(path), *path.parents))
        if error.filename is not None and str(error.filename) not in known_paths:
            raise
        expected = EXPECTED_BY_ERRNO.get(error.errno, "a path that can be written")
        raise refused(error, path, PLACE, expected) from error


def _temporary_path(path: Path) -> Path:
    """The path at which a file is written before it is whole."""
    return path.with_name(f".{path.name}.part")


def _refuse_others(path: Path) -> None:
    """Refuse a path that is no regular file: a folder, or a device, which would be replaced."""
    if path.is_dir():
        raise InputError(path, PLACE, "a folder", "a file's path")
    if path.exists() and not path.is_file():
        raise InputError(path, PLACE, "a device or a pipe", "a file's path")


def _locked_descriptor(path: Path, temporary: Path) -> int:
    """The locked descriptor of the temporary file."""
    while True:
        descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT, 0o666)
        if not _has_lock(descriptor):
            os.close(descriptor)
            raise InputError(path, PLACE, "another run that writes it", "one run after the other")
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), os.stat(temporary)):
                return descriptor
        os.close(descriptor)  # another run has just finished with it


def _has_lock(descriptor: int) -> bool:
    """Whether the lock was obtained; on a file system without locks, always."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True
