"""What long work says of itself."""

import sys

import pytest

from eitskin import progress
from eitskin.progress import LINE_S, patient


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test sets."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def passed(items, clock, seconds, **kwargs):
    for _ in patient(items, "epochs", **kwargs):
        clock[0] += seconds


def test_a_log_has_a_line_now_and_then(clock, capsys):
    passed(range(100), clock, LINE_S / 2.0)
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["epochs: 2 of 100, 24:30 left", "epochs: 4 of 100, 24:00 left"]
    assert lines[-1] == "epochs: 98 of 100, 0:30 left" and len(lines) == 49


def test_of_how_many_is_said_where_it_is_known(clock, capsys):
    passed(iter(range(3)), clock, LINE_S)
    assert capsys.readouterr().err.splitlines() == ["epochs: 1", "epochs: 2"]


def test_what_is_soon_done_says_nothing(clock, capsys):
    passed(range(10), clock, 0.09 * LINE_S)
    passed(range(10), clock, LINE_S, shown=False)
    assert capsys.readouterr() == ("", "")


def test_whoever_watches_has_a_bar(clock, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(progress, "QUIET_S", 0.0)
    passed(range(3), clock, LINE_S)
    assert "epochs" in (said := capsys.readouterr().err) and "\r" in said
