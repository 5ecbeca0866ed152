"""What stops a workflow's job: one line, in its log too."""

import json

import pytest

from eitskin import answers
from eitskin.errors import InputError, refused, reported
from eitskin.quantities import plain

OBEYED = "\x1b[2J\x07\x9b31m\u202e"


def test_a_job_that_is_interrupted_says_so_in_its_log_alone(tmp_path, capsys):
    log = tmp_path / "logs" / "job.log"
    with pytest.raises(SystemExit) as stopped, reported(log):
        raise KeyboardInterrupt
    assert stopped.value.code == 130 and capsys.readouterr().err == ""
    assert log.read_text() == "interrupted: the same command goes on\n"


def test_a_job_whose_input_is_refused_says_why_in_its_log_and_on_stderr(tmp_path, capsys):
    log = tmp_path / "job.log"
    with pytest.raises(SystemExit) as stopped, reported(log):
        raise InputError("a.csv", "line 2", "nothing", "a number")
    said = str(InputError("a.csv", "line 2", "nothing", "a number"))
    assert stopped.value.code == 1 and capsys.readouterr().err == said + "\n"
    assert log.read_text() == said + "\n"


def test_a_refusal_quotes_what_a_file_holds_in_few_characters():
    refusal = InputError(
        "a.csv", "key " + "k" * 10**5, repr([0.1] * 10**4), "one of " + "x" * 10**5
    )
    assert len(str(refusal)) < 2500 and "(50000 characters)" in refusal.actual
    assert str(InputError("a.csv", refusal.place, refusal.actual, refusal.expected)) == str(refusal)


def test_nothing_that_a_terminal_obeys_is_printed(tmp_path, capsys):
    refusal = InputError(f"{OBEYED}\udc80.csv", f"key {OBEYED}", OBEYED, f"not {OBEYED}\n")
    texts = [str(refusal), str(refused(OSError(2, "", OBEYED))), plain(f"{OBEYED}\u00a0V\r")]
    answers.write({"found": f"{OBEYED}\x7f"})
    texts.append(printed := capsys.readouterr().out.replace("\n", ""))
    assert all(text.isprintable() for text in texts)
    assert json.loads(printed) == {"found": f"{OBEYED}\x7f"}
    with pytest.raises(SystemExit), reported(tmp_path / "job.log"):
        raise refusal
    assert (tmp_path / "job.log").read_text("utf-8") == f"{refusal}\n"
