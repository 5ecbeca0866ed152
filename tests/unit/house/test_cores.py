"""Parts of one computation on as many cores as there are: the same results, in order."""

import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from eitskin import cores
from eitskin.diagnose.noise.whitening import ErrorColumns, Whitening
from eitskin.errors import InputError


def on(monkeypatch, count):
    """So many cores, whatever the machine has."""
    monkeypatch.setenv("OMP_NUM_THREADS", str(count))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_are_in_the_order_of_their_parts(monkeypatch, count):
    on(monkeypatch, count)
    assert cores.threaded(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert cores.threaded(len, []) == []


def test_two_parts_run_at_once_on_two_cores(monkeypatch):
    on(monkeypatch, 2)
    both = threading.Barrier(2, timeout=20.0)
    assert sorted(cores.threaded(lambda _: both.wait(), range(2))) == [0, 1]


def test_parts_of_a_part_stay_on_its_core(monkeypatch):
    on(monkeypatch, 2)

    def inner(_):
        return cores.threaded(lambda _: threading.get_ident(), range(3))

    for own in cores.threaded(inner, range(4)):
        assert len(set(own)) == 1


def test_an_error_of_a_part_is_raised(monkeypatch):
    on(monkeypatch, 2)
    with pytest.raises(ZeroDivisionError):
        cores.threaded(lambda n: 1 / n, [2, 1, 0])


def test_a_process_forked_from_one_with_threads_has_its_own(monkeypatch):
    on(monkeypatch, 2)
    cores.threaded(abs, range(4))
    child = os.fork()
    if child == 0:
        os._exit(0 if cores.threaded(abs, range(-3, 0)) == [3, 2, 1] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_shares_are_even_and_keep_groups_together():
    groups = ["aaaa", "b", "cc", "ddd", "e"]
    shares = cores.shares(groups)
    assert sorted("".join("".join(share) for share in shares)) == sorted("".join(groups))
    assert sorted(map(len, shares)) == [5, 6]
    for group in groups:
        assert sum(group[0] in share for share in shares) == 1
    assert cores.shares(["abc"]) == [["a", "b", "c"]] and cores.shares([]) == []


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_of_forked_parts_are_in_their_order(monkeypatch, count):
    on(monkeypatch, count)
    assert cores.forked(lambda n: time.sleep(0.02 * (5 - n)) or n * n, range(5)) == [0, 1, 4, 9, 16]
    assert cores.forked(len, []) == []


def test_two_forked_parts_run_at_once_on_two_cores(monkeypatch):
    on(monkeypatch, 2)
    here, there = os.pipe()

    def met(part):
        if part:
            os.write(there, b"!")
            return True
        return os.read(here, 1) == b"!"

    assert cores.forked(met, [0, 1]) == [True, True]


def test_what_is_forked_is_forked_from_one_thread(monkeypatch):
    on(monkeypatch, 2)
    before = threading.active_count()
    assert cores.threaded(abs, range(-3, 0)) == [3, 2, 1]
    assert threading.active_count() > before
    assert cores.forked(lambda _: threading.active_count(), [0]) == [1]
    assert threading.active_count() == before
    assert cores.threaded(abs, range(-3, 0)) == [3, 2, 1]


def test_what_a_forked_part_changes_is_lost_but_for_its_result(monkeypatch):
    on(monkeypatch, 2)
    table, own = np.arange(3.0), {}

    def changed(part):
        own[part] = table[part] = 7.0
        return own

    results = cores.forked(changed, range(2))
    assert own == {} and table.tolist() == [0.0, 1.0, 2.0]
    assert [list(own) for own in results] == [[0], [1]]


def test_what_processes_share_is_the_same_in_their_results(monkeypatch):
    on(monkeypatch, 2)
    large, small, other = np.zeros(100_000), {"of": 1}, [2]
    results = cores.forked(lambda part: (part, large, [small], other), range(2), [large, small])
    for part, (number, first, (second,), third) in enumerate(results):
        assert number == part and first is large and second is small
        assert third == other and third is not other


def test_a_forked_part_stays_on_its_core(monkeypatch):
    on(monkeypatch, 2)

    def inside(_):
        return len(set(cores.threaded(lambda _: threading.get_ident(), range(4))))

    assert cores.forked(inside, range(2)) == [1, 1]


def test_an_error_of_a_forked_part_is_raised_as_it_was(monkeypatch):
    on(monkeypatch, 2)

    def refused(part):
        if part:
            raise InputError("a.csv", "row 3", "7 columns", "8")
        return part

    with pytest.raises(InputError, match="row 3: found 7 columns, expected 8") as error:
        cores.forked(refused, range(3))
    assert error.value.place == "row 3"


def test_the_seconds_of_forked_parts_count(monkeypatch):
    on(monkeypatch, 2)

    def busy(_):
        end = time.process_time() + 0.1
        while time.process_time() < end:
            pass

    before, own = cores.seconds(), time.process_time()
    cores.forked(busy, range(3))
    others = cores.seconds() - before - (time.process_time() - own)
    assert 0.25 < others < 3.0


def test_a_forked_part_that_is_killed_is_an_error(monkeypatch):
    on(monkeypatch, 2)
    with pytest.raises(MemoryError, match="killed"):
        cores.forked(lambda part: os.kill(os.getpid(), signal.SIGKILL), [1])
    with pytest.raises(RuntimeError, match="code 3, no answer"):
        cores.forked(lambda part: os._exit(3), [1])


class Unread(Exception):
    """One that is written, and cannot be read again."""

    def __init__(self, one, other):
        super().__init__(one)


@pytest.mark.parametrize("error", [Unread("here", 1), ValueError(lambda: "here")])
def test_what_cannot_be_told_is_told_in_words(error):
    def failed(part):
        raise error

    with pytest.raises(RuntimeError, match="in failed\n"):
        cores.forked(failed, [1])


def test_an_error_of_a_forked_part_says_where_it_was():
    with pytest.raises(ZeroDivisionError) as error:
        cores.forked(lambda part: 1 / part, [0])
    assert "test_cores.py" in error.value.__notes__[0]


def test_parts_of_a_forked_part_stay_on_its_core(monkeypatch):
    on(monkeypatch, 2)

    def inside(_):
        return cores.forked(lambda _: vars(cores._thread_state)["busy"], range(2))

    assert cores.forked(inside, range(2)) == [[True, True], [True, True]]


def test_a_daemonic_process_may_fork():
    with get_context("fork").Pool(1) as pool:
        assert pool.apply(cores.forked, (abs, [-1, 2])) == [1, 2]


def held():
    """Files and processes of this process."""
    children = Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text()
    return os.listdir("/proc/self/fd"), children


def test_nothing_is_left_of_what_was_forked(monkeypatch):
    on(monkeypatch, 2)
    before = held()
    for _ in range(5):
        cores.forked(lambda part: part, range(4))
    with pytest.raises(ZeroDivisionError):
        cores.forked(lambda part: time.sleep(60.0 * part) or 1 / part, range(2))
    assert held() == before


ORPHANED = """
import os, time
from eitskin import cores

def large(part):
    os.write(1, b"begun\\n")
    time.sleep(1.0)
    return bytes(1_000_000)

cores.forked(large, range(2))
"""

NESTED = """
import os, time
from eitskin import cores

def long(part):
    os.write(1, b"begun\\n")
    time.sleep(60.0)

cores.forked(lambda part: cores.forked(long, [part]), range(2))
"""


@pytest.mark.parametrize("script", [ORPHANED, NESTED], ids=["parts", "parts of parts"])
def test_forked_parts_end_with_whoever_waited_for_them_and_was_killed(script):
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    command = [sys.executable, "-c", script]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    assert [process.stdout.readline() for _ in range(2)] == ["begun\n"] * 2
    process.kill()
    said, _ = process.communicate(timeout=30.0)  # until nobody holds its stdout
    assert said == ""


INTERRUPTED = """
import os, sys, time
from eitskin import cores

def long(part):
    os.write(1, b"begun\\n")
    time.sleep(60.0)

try:
    cores.forked(long, range(2))
except KeyboardInterrupt:
    sys.exit(5)
"""


def test_forked_parts_end_with_whoever_is_interrupted():
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert process.stdout is not None
    assert [process.stdout.readline() for _ in range(2)] == ["begun\n"] * 2
    start = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=30.0)  # until nobody holds its stdout
    assert process.returncode == 5 and said == ""
    assert time.monotonic() - start < 30.0


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
    errors = ErrorColumns(
        **columns, press=draw.normal(size=(1, frames, channels)), press_label=label
    )
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


@pytest.mark.parametrize("allowed", ["1", "2"])
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_parts_that_are_spread_keep_their_order(monkeypatch, allowed, count):
    monkeypatch.setenv("OMP_NUM_THREADS", allowed)
    here = os.getpid()
    found = cores.spread(lambda part: (part, os.getpid()), range(count))
    assert [part for part, _ in found] == list(range(count))
    assert all((process == here) == (cores.at_once() < 2) for _, process in found)
