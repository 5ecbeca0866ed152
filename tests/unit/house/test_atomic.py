"""Files that are there whole or not at all."""

import pytest

from eitskin.atomic import atomic_path
from eitskin.errors import InputError


def write(path, text):
    with atomic_path(path) as temporary:
        temporary.write_text(text)


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "new" / "file.txt"
    write(path, "old")
    with pytest.raises(ZeroDivisionError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


def test_what_a_killed_write_left_is_gone_after_the_next(tmp_path):
    path = tmp_path / "file.txt"
    killed = atomic_path(path)
    killed.__enter__().write_text("half of a file, longer than the whole")
    assert len(list(tmp_path.iterdir())) == 1
    write(path, "whole")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["whole"]


def test_a_folder_and_a_path_below_a_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="file to write: found a folder"):
        write(tmp_path, "text")
    (tmp_path / "file").write_text("kept")
    for below in ("file/out.txt", "file/deeper/out.txt"):
        with pytest.raises(InputError, match="found a file above it"):
            write(tmp_path / below, "text")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["kept"]
