"""Files that are folded small: whether what they hold is far more than readings could be folded
to, asked before it is unfolded."""

import zipfile
from pathlib import Path

from eitskin.errors import InputError

LEAST_BYTES = 1 << 28  # unfolded: any machine holds as much
MAX_RATIO = 100  # unfolded over folded: noise keeps readings far below


def refuse(path: str | Path, size: int) -> None:
    """Raise InputError where a file's content, `size` bytes or more, is too much."""
    folded = Path(path).stat().st_size
    if size > max(LEAST_BYTES, MAX_RATIO * folded):
        actual = f"{folded:,} bytes that unfold to {size:,} or more"
        expected = f"at most {MAX_RATIO} times as many, as the noise of readings folds no smaller"
        raise InputError(path, "file", actual, expected)


def refuse_archive(path: str | Path) -> None:
    """`refuse` a zip archive by the sizes that it states; raises BadZipFile for another file."""
    with zipfile.ZipFile(path) as archive:
        refuse(path, sum(entry.file_size for entry in archive.infolist()))
