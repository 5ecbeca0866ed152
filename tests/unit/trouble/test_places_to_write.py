"""Where a command writes: no room, no permission, another run, a kill. A file is there whole or not
at all, and the message names it."""

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import sample_files as sound
from eitskin import cli
from eitskin.atomic import atomic_path, held_folder
from eitskin.data import recording

FULL = Path("/dev/full")
NOBODY = 65534


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return Path()


@pytest.fixture
def nobody(here):
    """Someone to whom permissions apply, as to root they do not."""
    sound.parquet(here)
    root = os.geteuid() == 0
    if root:
        here.chmod(0o777)
        os.seteuid(NOBODY)
    yield
    if root:
        os.seteuid(0)


def refused(words: list, capsys: pytest.CaptureFixture) -> str:
    """The one line on stderr, after which the same files lie there."""
    before = {path: path.read_bytes() for path in Path().rglob("*.parquet") if path.is_file()}
    assert cli.main([str(word) for word in words]) == cli.REFUSED
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1, printed.err
    assert before == {
        path: path.read_bytes() for path in Path().rglob("*.parquet") if path.is_file()
    }
    assert not [path for path in Path().rglob("*.part") if not path.is_symlink()]
    return printed.err


@pytest.mark.parametrize(
    ("out", "found", "expected"),
    [
        (".", "a folder", "a file's path"),
        ("skin.parquet/out.parquet", "a file above it", "a path in a folder"),
        ("n" * 300, "File name too long", "a shorter name"),
        ("pipe", "a device or a pipe", "a file's path"),
        ("/proc/out.parquet", "No such file or directory", "a path that can be written"),
    ],
)
def test_a_path_that_no_file_can_have(here, capsys, out, found, expected):
    path = sound.parquet(here)
    os.mkfifo("pipe")
    said = refused(["import", path, out], capsys)
    assert said == f"{out}: file to write: found {found}, expected {expected}\n"
    assert Path("pipe").is_fifo()


@pytest.mark.skipif(not FULL.is_char_device(), reason="no /dev/full here")
@pytest.mark.parametrize(
    ("command", "out"),
    [
        (["import", "skin.parquet"], "out.parquet"),
        (["compare", "skin.parquet", "skin.parquet"], "out/comparison.json"),
        (["compare", "skin.parquet", "skin.parquet"], "out/comparison.html"),
        (["diagnose", "skin.parquet", "--anyway"], "out/recording.parquet"),
    ],
)
def test_a_full_disk_names_the_file(here, capsys, command, out):
    sound.parquet(here)
    target = Path(out)
    target.parent.mkdir(exist_ok=True)
    (target.parent / f".{target.name}.part").symlink_to(FULL)
    where = ["--out", "out"] if target.parent.name else [out]
    assert cli.main([*command, *where]) == cli.REFUSED
    last = capsys.readouterr().err.splitlines()[-1]
    found = "found No space left on device, expected room on the disk"
    assert last == f"{out}: file to write: {found}"
    assert not target.exists() and not list(target.parent.glob(".*.part"))


def test_a_file_beyond_the_limit_is_not_half_written(here, capsys):
    path = sound.parquet(here)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        said = refused(["import", path, "out.parquet"], capsys)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert said.startswith("out.parquet: file to write: found File too large, expected room")
    assert not Path("out.parquet").exists()


@pytest.mark.parametrize("mode", [0o500, 0o000])
def test_a_folder_that_may_not_be_written_to(nobody, capsys, mode):
    Path("locked").mkdir(mode=mode)
    said = refused(["import", "skin.parquet", "locked/out.parquet"], capsys)
    found = "found Permission denied, expected a folder that may be written to"
    assert said == f"locked/out.parquet: file to write: {found}\n"


@pytest.mark.parametrize("command", [["check"], ["import", "out.parquet"]])
def test_a_file_that_may_not_be_read(nobody, capsys, command):
    Path("other.parquet").touch(mode=0)
    assert cli.main([command[0], "other.parquet", *command[1:]]) == cli.REFUSED
    said = capsys.readouterr().err
    found = "found Permission denied, expected one that can be read and written"
    assert said == f"other.parquet: file: {found}\n"


@pytest.mark.skipif(shutil.which("unshare") is None, reason="no unshare here")
def test_a_read_only_disk_names_the_file(here):
    sound.parquet(here)
    Path("disk").mkdir()
    run = f"{sys.executable} -m eitskin.cli import skin.parquet disk/out.parquet"
    mount = "mount -t tmpfs -o ro tmpfs disk"
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", f"{mount} || exit 99; {run}"], capture_output=True, text=True
    )
    if done.returncode == 99 or "unshare" in done.stderr:
        pytest.skip("no disk may be mounted here")
    assert done.returncode == cli.REFUSED and "Traceback" not in done.stderr
    found = "found Read-only file system, expected a disk that may be written to"
    assert done.stderr == f"disk/out.parquet: file to write: {found}\n"


def test_two_runs_into_one_folder(here, capsys):
    path = sound.parquet(here)
    with held_folder("out"):
        said = refused(["compare", path, path, "--out", "out"], capsys)
        assert said.startswith("out: folder to write: found another run that writes into it")
        assert cli.main(["diagnose", str(path), "--anyway", "--out", "out"]) == cli.REFUSED
        assert "out: folder to write: found another run" in capsys.readouterr().err
    assert list(Path("out").iterdir()) == []


def test_two_runs_to_one_file(here, capsys):
    path = sound.parquet(here)
    with atomic_path("out.parquet"):
        assert cli.main(["import", str(path), "out.parquet"]) == cli.REFUSED
        found = "found another run that writes it, expected one run after the other"
        assert capsys.readouterr().err == f"out.parquet: file to write: {found}\n"


def test_an_unusable_recording_writes_nothing(here, capsys):
    made = sound.made()
    made.voltage[:] = 0.0
    recording.write(made, "zero.parquet")
    for words in (["import", "zero.parquet", "out.parquet"], ["diagnose", "zero.parquet"]):
        assert cli.main(words) == cli.UNUSABLE
        printed = capsys.readouterr()
        assert printed.err.startswith("zero.parquet: dead: 0 of 40 channels have a reading other")
        assert [path.name for path in Path().iterdir()] == ["zero.parquet"]
    assert cli.main(["diagnose", "zero.parquet", "--anyway"]) == cli.REFUSED
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("zero.parquet: column voltage_V: found 0 in every frame")
    assert not Path("diagnosis-zero/report.html").exists()


def test_an_import_that_is_killed_leaves_the_whole_file_or_none(here):
    path, out = sound.parquet(here), Path("out.parquet")
    loop = (
        "import sys; from eitskin import cli\n"
        "print('ready', flush=True)\n"
        "while True: cli.main(['import', 'skin.parquet', 'out.parquet'])\n"
    )
    draw = random.Random(1)
    for _ in range(3):
        out.unlink(missing_ok=True)
        run = subprocess.Popen([sys.executable, "-c", loop], stdout=subprocess.PIPE)
        run.stdout.readline()
        time.sleep(draw.uniform(0.0, 0.5))
        run.send_signal(signal.SIGKILL)
        run.wait()
        run.stdout.close()
        assert {file.name for file in here.iterdir()} <= {path.name, out.name, ".out.parquet.part"}
        if out.exists():
            assert pq.read_table(out).num_rows == len(sound.FORCES_N)
        assert cli.main(["import", str(path), str(out)]) == 0
        assert not Path(".out.parquet.part").exists()


def test_the_clock_of_the_machine_may_go_back(here, capsys):
    path = sound.parquet(here)
    os.utime(path, (4e9, 4e9))
    assert cli.main(["import", str(path), "out.parquet", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["out"] == "out.parquet"
    os.utime("out.parquet", (0, 0))
    assert cli.main(["import", str(path), "out.parquet"]) == 0
    assert Path("out.parquet").read_bytes() == path.read_bytes()
