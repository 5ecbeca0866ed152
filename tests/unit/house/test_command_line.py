"""What a program that calls `eitskin` relies on: exit codes, --json, --version."""

import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import sample_files as sound
from eitskin import cli
from eitskin.data import recording
from eitskin.data.check import check

DOCS = Path(__file__).parents[3] / "docs" / "command_line.md"
ANSWERING = ("check", "import", "diagnose", "compare", "skin", "stream")


@pytest.fixture
def path(make_recording, tmp_path, monkeypatch):
    """A usable recording in the working directory."""
    monkeypatch.chdir(tmp_path)
    recording.write(make_recording(), "skin.parquet")
    return Path("skin.parquet")


def left_with(words, capsys):
    """Code and output of a command that leaves through argparse."""
    with pytest.raises(SystemExit) as left:
        cli.main(words)
    return left.value.code, capsys.readouterr()


def answer(words, capsys):
    """Code, the one document on stdout, and stderr."""
    code = cli.main([*words, "--json"])
    printed = capsys.readouterr()
    return code, json.loads(printed.out), printed.err


def test_the_version(capsys):
    code, printed = left_with(["--version"], capsys)
    assert code == 0 and printed.out == f"eitskin {version('eitskin')}\n"


def test_exit_codes_stand_in_the_help_and_in_the_docs(capsys):
    _, printed = left_with(["--help"], capsys)
    told = re.findall(r"^  (\d+|128\+n)  +(\S.*)$", cli.EXIT_CODES, re.MULTILINE)
    assert [code for code, _ in told] == ["0", "1", "2", "3", "4", "128+n"]
    documented = DOCS.read_text(encoding="utf-8")
    for code, meaning in told:
        assert meaning in printed.out
        assert f"| {code} | {meaning} |" in documented


@pytest.mark.parametrize("command", ANSWERING)
def test_every_help_has_examples_that_parse(command, capsys):
    _, printed = left_with([command, "--help"], capsys)
    examples = re.findall(r"^  eitskin (.*)$", cli.EXAMPLES[command], re.MULTILINE)
    assert examples
    for example in examples:
        assert example in printed.out
        words = re.split(r" [|>] ", example)[0].split()
        assert words[0] == command and cli._parser().parse_args(words).run


@pytest.mark.parametrize("words", [[], ["chekc"], ["check"], ["check", "a", "b"], ["import", "a"]])
def test_wrong_usage_is_2(words, capsys):
    code, printed = left_with(words, capsys)
    assert code == 2 and printed.out == "" and printed.err.startswith("usage: eitskin")


@pytest.mark.parametrize(
    "words", [["check", "a", "--oops"], ["check", "a", "b"], ["rig", "check", "a", "--oops"]]
)
def test_what_a_command_does_not_know_shows_its_own_usage(words, capsys):
    own = " ".join(words[: words.index("a")])
    code, printed = left_with(words, capsys)
    assert code == 2 and printed.err.startswith(f"usage: eitskin {own} [-h]")
    assert f"eitskin {own}: error: unrecognized arguments: {words[-1]}" in printed.err


def test_check_answers(path, capsys):
    code, said, err = answer(["check", str(path)], capsys)
    assert code == 0 and err == ""
    assert (said["format"], said["version"], said["file"]) == ("eit-check", 1, "skin.parquet")
    found = check(recording.read(path))
    assert said["usable"] is True is found.ok
    assert [one["sentence"] for one in said["findings"]] == [f.sentence for f in found.findings]
    assert {*said["findings"][0]} == {"topic", "severity", "sentence", "value", "remedy"}


def test_import_answers(path, capsys):
    code, said, err = answer(["import", str(path), "out.parquet"], capsys)
    assert code == 0 and err == "" and said["usable"] and said["out"] == "out.parquet"


def test_import_says_what_it_took_and_where_it_went(path, capsys):
    assert cli.main(["import", str(path), "out.parquet"]) == 0
    printed = capsys.readouterr()
    frames, channels, *warnings, out = printed.out.splitlines()
    assert frames.startswith("frames: a recording of 165 frames: 45 untouched, 120 touched")
    assert channels.startswith("channels: 208 of 16 electrodes")
    warned = check(recording.read(path)).of_severity("warning")
    assert (len(warnings), out, printed.err) == (len(warned), "out.parquet", "")


def test_compare_answers(path, capsys):
    words = ["compare", str(path), str(path), "--out", "out"]
    code, said, _ = answer(words, capsys)
    written = json.loads(Path("out/comparison.json").read_text(encoding="utf-8"))
    assert code == 0 and said == written | {"report": "out/comparison.html"}
    assert Path(said["report"]).is_file()


def test_compare_takes_stretches_of_one_recording(path, capsys):
    made = recording.read(path)
    drive = (made.channels[:, :2] == made.channels[0, :2]).all(axis=1)
    made.voltage = made.voltage * np.where(drive & (np.arange(165) >= 80)[:, None], 1.05, 1.0)
    recording.write(made, "stepped.parquet")
    stretches = ["--control-frames", "0:79", "--later-frames", "80:164"]
    code, said, _ = answer(["compare", "stepped.parquet", "stepped.parquet", *stretches], capsys)
    assert code == 0
    assert said["parts"] == ["stepped, frames 0 to 79", "stepped, frames 80 to 164"]
    sentence = "In stepped, frames 80 to 164, what is driven from electrode 0 reads 4.99 % more"
    assert said["sentences"][0].startswith(sentence)
    folder = "comparison-stepped-frames-0-79-vs-stepped-frames-80-164"
    assert said["report"] == f"{folder}/comparison.html"


def test_compare_checks_the_tables_of_both_first(path, capsys):
    made = recording.read(path)
    made.metadata["channels"] = made.channels[:, [0, 1, 3, 2]].tolist()
    recording.write(made, "turned.parquet")
    for files in ([str(path), "turned.parquet"], ["turned.parquet", str(path)]):
        code, said, err = answer(["compare", *files, "--out", "out"], capsys)
        assert code == cli.UNUSABLE and said["usable"] is False
        assert err.startswith("turned.parquet: polarity: wrong channel table")
    same = ["turned.parquet", "turned.parquet", "--out", "out", "--anyway"]
    assert answer(["compare", *same], capsys)[0] == 0


def test_compare_refuses_other_units(path, capsys):
    made = recording.read(path)
    made.voltage = 1e3 * made.voltage
    recording.write(made, "mV.parquet")
    code, _, err = answer(["compare", str(path), "mV.parquet", "--out", "out"], capsys)
    assert code == cli.REFUSED and "found readings 1000 times those of" in err
    made.voltage = 1.5e-3 * made.voltage
    recording.write(made, "more.parquet")
    assert answer(["compare", str(path), "more.parquet", "--out", "out"], capsys)[0] == 0


def test_what_is_unusable_answers_and_is_2(path, capsys):
    made = recording.read(path)
    made.voltage = 0.0 * made.voltage
    recording.write(made, "zero.parquet")
    for words in (["check"], ["diagnose"], ["import", "out.parquet"]):
        code, said, _ = answer([words[0], "zero.parquet", *words[1:]], capsys)
        assert code == cli.UNUSABLE and said["usable"] is False
        assert [one["topic"] for one in said["findings"] if one["severity"] == "error"] == ["dead"]


@pytest.mark.parametrize(
    "words", [["check", "a"], ["import", "a", "b"], ["diagnose", "a"], ["compare", "a", "a"]]
)
def test_a_refusal_answers_and_is_1(path, words, capsys):
    code, said, err = answer(words, capsys)
    assert code == cli.REFUSED and said["format"] == "eit-refusal"
    assert (said["file"], said["place"], said["found"]) == ("a", "file", "no such file")
    assert err == "{file}: {place}: found {found}, expected {expected}\n".format(**said)


def test_a_number_that_is_none_is_null(path, capsys):
    made = recording.read(path)
    made.voltage = np.where(np.arange(208) == 0, np.nan, made.voltage)
    recording.write(made, "lost.parquet")
    code, said, _ = answer(["check", "lost.parquet"], capsys)
    assert code == 0 and any(one["value"] is None for one in said["findings"])


def run(words, **streams):
    return subprocess.Popen(
        [sys.executable, "-m", "eitskin.cli", *words], stderr=subprocess.PIPE, text=True, **streams
    )


@pytest.mark.parametrize("words", [["check", "SKIN"], ["--print-completion", "bash"]])
def test_nobody_reads_the_output(path, words):
    reader = subprocess.Popen(["true"], stdin=subprocess.PIPE)
    reader.wait()
    checking = run([str(path) if one == "SKIN" else one for one in words], stdout=reader.stdin)
    reader.stdin.close()
    _, err = checking.communicate()
    assert checking.returncode == 141 and err == ""


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no /dev/full here")
def test_no_room_for_the_output(path):
    with open("/dev/full", "w") as full:
        checking = run(["check", str(path)], stdout=full)
        _, err = checking.communicate()
    assert checking.returncode == cli.REFUSED
    assert err.startswith("standard output: file: found No space left on device, expected ")
    assert err.count("\n") == 1


def test_a_name_that_is_no_text(path, capsys):
    odd = sound.parquet(Path()).rename("sk\udcffin.parquet")
    assert cli.main(["check", str(odd), "--json"]) == 0
    assert cli.answers.name(str(odd)) == "sk\ufffdin"
