"""Files that are there whole or not at all."""

import os
import signal

import pytest

from eitskin.atomic import atomic_path, held_folder
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
    writer = os.fork()
    if writer == 0:
        with atomic_path(path) as temporary:
            temporary.write_text("half of a file, longer than the whole")
            os.kill(os.getpid(), signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(writer, 0)[1]) == -signal.SIGKILL
    assert not path.exists() and len(list(tmp_path.iterdir())) == 1
    write(path, "whole")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["whole"]


def test_a_file_has_one_writer_at_a_time(tmp_path):
    path = tmp_path / "file.txt"
    with atomic_path(path) as temporary:
        temporary.write_text("first")
        with pytest.raises(InputError, match="another run that writes it"):
            write(path, "second")
        assert temporary.read_text() == "first"
    write(path, "third")
    assert path.read_text() == "third" and list(tmp_path.iterdir()) == [path]


def test_a_full_disk_names_the_file_and_leaves_what_was_there(tmp_path):
    path = tmp_path / "file.txt"
    write(path, "old")
    (tmp_path / ".file.txt.part").symlink_to("/dev/full")
    with pytest.raises(InputError) as refused:
        write(path, "new")
    found = "file to write: found No space left on device, expected room on the disk"
    assert str(refused.value) == f"{path}: {found}"
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_a_pipe_is_refused_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="file to write: found a device or a pipe"):
        write(pipe, "text")
    assert pipe.is_fifo() and list(tmp_path.iterdir()) == [pipe]


def test_another_file_s_error_is_its_own(tmp_path):
    with pytest.raises(FileNotFoundError, match="absent"), atomic_path(tmp_path / "file.txt"):
        (tmp_path / "absent").read_bytes()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_one_run_s_at_a_time(tmp_path):
    with held_folder(tmp_path / "out"):
        with (
            pytest.raises(InputError, match="found another run that writes into it"),
            held_folder(tmp_path / "out"),
        ):
            pass
        write(tmp_path / "out" / "file.txt", "text")
    with held_folder(tmp_path / "out") as folder:
        assert [file.name for file in folder.iterdir()] == ["file.txt"]


def test_a_folder_and_a_path_below_a_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="file to write: found a folder"):
        write(tmp_path, "text")
    (tmp_path / "file").write_text("kept")
    for below in ("file/out.txt", "file/deeper/out.txt"):
        with pytest.raises(InputError, match="found a file above it"):
            write(tmp_path / below, "text")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["kept"]
