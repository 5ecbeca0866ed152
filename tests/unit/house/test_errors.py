"""What stops a workflow's job: one line, in its log too."""

import pytest

from eitskin.errors import InputError, reported


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
