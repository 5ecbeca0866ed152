"""A recording with a step: what the commands say of it, and its frames before and after apart."""

import shlex

import numpy as np
import pytest

from eitskin import cli
from eitskin.data import recording
from eitskin.data.check.steps import steps
from eitskin.diagnose import diagnosis
from eitskin.errors import InputError

STEPS = 33, 57


@pytest.fixture
def path(make_recording, tmp_path):
    """A recording whose gain is switched twice, in a file with a name to be quoted."""
    path = tmp_path / "my skin.parquet"
    made = make_recording(presses=12)
    for frame in STEPS:
        made.voltage[frame:] *= 1.1
    recording.write(made, path)
    return path


def printed_commands(out: str) -> list[list[str]]:
    """The words of the commands that were printed."""
    lines = [line for line in out.splitlines() if line.startswith("  eitskin diagnose")]
    return [shlex.split(line) for line in lines]


def test_check_prints_the_commands_that_diagnose_apart(path, tmp_path, capsys):
    assert cli.main(["check", str(path)]) == 0
    out = capsys.readouterr().out
    found = [step.frame for step in steps(recording.read(path))]
    assert len(found) == len(STEPS)
    assert f"Steps at frames {found[0]} and {found[1]}: what lies before and after" in out
    parts = []
    for number, (*command, option, frames) in enumerate(printed_commands(out)):
        assert command == ["eitskin", "diagnose", str(path)] and option == "--frames"
        part = tmp_path / f"{number}.parquet"
        assert cli.main(["import", str(path), str(part), "--frames", frames]) == 0
        parts.append(recording.read(part))
    assert not any(steps(part) for part in parts)
    together = np.concatenate([part.voltage for part in parts])
    assert np.array_equal(together, recording.read(path).voltage)


def test_steps_of_a_stretch_have_the_frames_of_the_file(path, capsys):
    found = [step.frame for step in steps(recording.read(path))]
    last = len(recording.read(path).frames) - 1
    assert cli.main(["check", str(path), "--frames", f"3:{last}"]) == 0
    frames = [command[-1] for command in printed_commands(capsys.readouterr().out)]
    assert frames == [f"3:{found[0] - 1}", f"{found[0]}:{found[1] - 1}", f"{found[1]}:{last}"]


def test_diagnose_says_it_before_it_begins_and_keeps_what_was_stated(
    path, tmp_path, monkeypatch, capsys
):
    def stopped(*_arguments, **_options):
        raise InputError("diagnosis", "begin", "enough", "no more")

    monkeypatch.setattr(diagnosis, "diagnose", stopped)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "skin.yaml").write_text("thickness_mm: 4.0\n")
    stated = ["--skin", "skin.yaml"]
    assert cli.main(["diagnose", str(path), *stated]) == 1
    commands = printed_commands(capsys.readouterr().out)
    assert len(commands) == 3
    assert all(command[3:-2] == stated for command in commands)
    assert cli.main(commands[1][1:]) == 1
    said = capsys.readouterr().out
    first, last = commands[1][-1].split(":")
    assert f"frames: {first} to {last} of the file" in said and "eitskin diagnose" not in said
    folder = tmp_path / f"diagnosis-my skin-frames-{first}-{last}"
    part = recording.read(folder / "recording.parquet")
    whole = recording.read(path).voltage[int(first) : int(last) + 1]
    assert np.array_equal(part.voltage, whole) and part.skin.thickness_mm == 4.0


def test_a_recording_without_a_step_has_no_commands(make_recording, tmp_path, capsys):
    path = tmp_path / "steady.parquet"
    recording.write(make_recording(presses=12), path)
    assert cli.main(["check", str(path)]) == 0
    assert "eitskin diagnose" not in capsys.readouterr().out


@pytest.mark.parametrize("frames", ["4", "a:b", "-1:4", "4:"])
def test_what_is_no_stretch_is_wrong_usage(path, frames, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(path), f"--frames={frames}"])
    assert ended.value.code == 2
    assert f"found '{frames}', expected FIRST:LAST, such as 0:99" in capsys.readouterr().err


def test_frames_beyond_the_end_are_one_line(path, capsys):
    assert cli.main(["check", str(path), "--frames", "10:9999"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith(f"{path}: frames: found 10:9999, expected FIRST:LAST, of frames")
