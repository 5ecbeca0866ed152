"""Independent parts on as many cores as there are: the same results, in order."""

import os
import threading

import numpy as np
import pytest

from eitskin import cores
from eitskin.diagnose.whitening import RigErrors, Whitening


def on(monkeypatch, count):
    """So many cores, whatever the machine has."""
    monkeypatch.setenv("OMP_NUM_THREADS", str(count))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_are_in_the_order_of_their_parts(monkeypatch, count):
    on(monkeypatch, count)
    assert cores.each(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert cores.each(len, []) == []


def test_two_parts_run_at_once_on_two_cores(monkeypatch):
    on(monkeypatch, 2)
    both = threading.Barrier(2, timeout=20.0)
    assert sorted(cores.each(lambda _: both.wait(), range(2))) == [0, 1]


def test_parts_of_a_part_stay_on_its_core(monkeypatch):
    on(monkeypatch, 2)

    def inner(_):
        return cores.each(lambda _: threading.get_ident(), range(3))

    for own in cores.each(inner, range(4)):
        assert len(set(own)) == 1


def test_an_error_of_a_part_is_raised(monkeypatch):
    on(monkeypatch, 2)
    with pytest.raises(ZeroDivisionError):
        cores.each(lambda n: 1 / n, [2, 1, 0])


def test_a_process_forked_from_one_with_threads_has_its_own(monkeypatch):
    on(monkeypatch, 2)
    cores.each(abs, range(4))
    child = os.fork()
    if child == 0:
        os._exit(0 if cores.each(abs, range(-3, 0)) == [3, 2, 1] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.parametrize(("said", "allowed"), [("3", 3), ("4,2", 4), ("0", 1)])
def test_how_many_cores_are_said(monkeypatch, said, allowed):
    on(monkeypatch, said)
    assert cores.allowed() == allowed


def test_without_a_word_all_cores_of_the_process_are_used(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert cores.allowed() == len(os.sched_getaffinity(0))


def whitening(draw, frames=30, channels=12):
    """One with errors of every kind."""
    columns = {k: draw.normal(size=(2, frames, channels)) for k in ("channel", "frame", "whole")}
    label = np.repeat(np.arange(frames // 5), 5)
    errors = RigErrors(**columns, press=draw.normal(size=(1, frames, channels)), label=label)
    there = np.ones((frames, channels), bool)
    one = np.ones(channels)
    return Whitening(there, one, one, errors=errors)


def test_bytes_do_not_depend_on_how_many_cores_there_are(monkeypatch):
    draw = np.random.default_rng(1)
    white, values = whitening(draw), draw.normal(size=(37, 30, 12))
    found = []
    for count in (1, 2, 3):
        on(monkeypatch, count)
        found.append(white(values).tobytes())
    assert found[0] == found[1] == found[2]
