"""Lines and the moments at which they ended; which frames began after a moment; ports."""

import itertools
import os
import pty
import threading
import tty

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data.board import Reject

serial = pytest.importorskip("serial", reason="pyserial is not installed: extra `rig`")

from eitskin.capture.lines import LONGEST_LINE, Line, Port, Splitter, is_frame_after  # noqa: E402

PERIOD_S = 0.35


def number(line: bytes) -> float | Reject | None:
    """A parser for these tests: whole numbers are readings, what begins with # is a remark."""
    if line.startswith(b"#"):
        return None
    return int(line) if line.strip().isdigit() else Reject("form", repr(line))


def fed(*chunks: tuple[bytes, float]) -> list[Line]:
    splitter = Splitter(number)
    return [line for chunk, now_s in chunks for line in splitter.feed(chunk, now_s)]


def test_what_stands_before_the_first_newline_is_nobodys_line():
    (line,) = fed((b"99", 1.0), (b"88\n1\n", 2.0))
    assert (line.value, line.number) == (1, 1)


def test_stale_bytes_joined_to_a_frame_are_left_out():
    lines = fed((b"12312", 1.0), (b"3\n7\n", 1.1))
    assert [line.value for line in lines] == [7]


def test_a_half_line_waits_for_its_end_and_has_its_time():
    lines = fed((b"\n12", 1.0), (b"3", 2.0), (b"4\n", 3.0))
    assert [(line.value, line.end_s, line.previous_end_s) for line in lines] == [(1234, 3.0, 1.0)]


def test_joined_lines_come_apart_with_one_time():
    lines = fed((b"\n", 0.0), (b"1\n2\n3\n", 5.0))
    assert [line.value for line in lines] == [1, 2, 3]
    assert [line.end_s for line in lines] == [5.0] * 3
    assert [line.previous_end_s for line in lines] == [0.0, 5.0, 5.0]


def test_a_remark_is_no_line_and_a_frame_behind_it_began_behind_the_one_before():
    early, later = fed((b"\n1\n", 1.0), (b"# gain 3\n", 2.0), (b"2\n", 3.0))
    assert (early.number, later.number) == (1, 2)
    assert (later.previous_end_s, later.previous_ok) == (1.0, True)


def test_a_rejected_line_is_counted_and_kept():
    early, second, third = fed((b"\n", 0.0), (b"1\nx\n2\n", 1.0))
    assert (early.ok, second.ok, third.ok) == (True, False, True)
    assert second.raw == b"x\n"
    assert (second.previous_ok, third.previous_ok) == (True, False)


def test_noise_without_an_end_is_dropped_and_the_next_newline_begins_anew():
    noise = b"7" * (LONGEST_LINE + 1)
    lines = fed((b"\n", 0.0), (noise, 1.0), (b"77\n5\n", 2.0))
    assert [line.ok for line in lines] == [False, True]
    assert lines[0].value.reason == "endless"
    assert lines[1].value == 5


@given(st.binary(max_size=300), st.lists(st.integers(0, 300), max_size=12))
def test_how_the_bytes_are_cut_does_not_matter(data, cuts):
    lines_at_once = Splitter(number).feed(data, 1.0)
    edges = [0, *sorted(cut for cut in cuts if cut < len(data)), len(data)]
    parts = [data[a:b] for a, b in itertools.pairwise(edges)]
    pieces = fed(*((part, 1.0) for part in parts))
    assert [(line.number, line.raw) for line in pieces] == [
        (line.number, line.raw) for line in lines_at_once
    ]


def frames(*moments: float, spoilt: frozenset[int] = frozenset()) -> list[Line]:
    """Frames whose lines end at these moments; the lines at `spoilt` are rejected."""
    chunks = [(b"x\n" if k in spoilt else b"1\n", s) for k, s in enumerate(moments)]
    return fed((b"\n", moments[0] - PERIOD_S), *chunks)


def taken(lines: list[Line], moment_s: float) -> float | None:
    """When the first frame ends that began after the moment."""
    ends = [line.end_s for line in lines if is_frame_after(line, moment_s, PERIOD_S)]
    return ends[0] if ends else None


def test_a_frame_that_began_after_settling_needs_two_line_ends_after_it():
    lines = frames(1.0, 1.35, 1.7, 2.05)
    assert taken(lines, 1.1) == 1.7
    assert taken(lines, 1.35) == 1.7
    assert taken(lines, 1.36) == 2.05
    assert taken(lines, 1.8) is None


def test_the_end_of_a_line_that_is_no_frame_says_nothing():
    lines = frames(1.0, 1.35, 1.7, 2.05, spoilt=frozenset({1}))
    assert taken(lines, 1.1) == 2.05


def test_a_stray_newline_just_before_a_frame_does_not_make_it_younger():
    # The frame that ends at 1.7 was being measured when somebody's newline came at 1.5.
    lines = fed((b"\n", 1.0), (b"1\n", 1.35), (b"\n", 1.5), (b"1\n", 1.7), (b"1\n", 2.05))
    assert taken(lines, 1.4) == 2.05


def test_lines_that_waited_in_a_buffer_are_not_young():
    # The host slept from 1.35 to 3.0; three frames come at once, with its time, not the board's.
    lines = frames(1.0, 1.35, 3.0, 3.0, 3.01, 3.36)
    assert taken(lines, 1.5) == 3.36


def test_two_frames_that_lost_the_newline_between_them_are_not_one():
    lines = frames(1.0, 1.35, 2.05 + 0.05, 2.45)
    assert taken(lines, 1.35) == 2.45


@given(
    st.lists(st.floats(0.3, 0.6), min_size=4, max_size=12),
    st.floats(0.0, 5.0),
    st.sets(st.integers(0, 11)),
)
def test_no_frame_that_is_taken_began_before_the_moment(gaps, moment_s, spoilt):
    ends, end = [], 0.0
    for gap in gaps:
        end += gap
        ends.append(end)
    lines = frames(*ends, spoilt=frozenset(spoilt))
    for line in lines:
        if is_frame_after(line, moment_s, PERIOD_S):
            begin_s = max((s for s in ends if s < line.end_s), default=0.0)
            assert begin_s >= moment_s
            assert line.ok


@pytest.fixture
def terminal():
    """A raw pseudo-terminal: the device's end, and the path of the host's."""
    device, host = pty.openpty()
    tty.setraw(device)
    tty.setraw(host)
    path = os.ttyname(host)
    os.close(host)
    yield device, path
    os.close(device)


def read(port: Port, n_wanted: int) -> list[Line]:
    lines: list[Line] = []
    while len(lines) < n_wanted and port.failure is None:
        last_number = lines[-1].number if lines else 0
        port.wait(last_number, 1.0)
        lines += port.since(last_number)
    return lines


def test_a_port_hears_what_is_sent_and_says_what_it_should(terminal):
    device, path = terminal
    port = Port(path, 115200, number, start=b"y")
    try:
        assert os.read(device, 1) == b"y"
        os.write(device, b"\n1\nx\n")
        os.write(device, b"2\n")
        assert [line.ok for line in read(port, 3)] == [True, False, True]
        assert [line.number for line in port.since(1)] == [2, 3]
    finally:
        port.close()


def test_a_line_that_came_before_the_wait_is_not_waited_for(terminal):
    device, path = terminal
    port = Port(path, 115200, number)
    try:
        os.write(device, b"\n1\n")
        while not port.since(0):
            port.wait(0, 1.0)
        waiting = threading.Thread(target=port.wait, args=(0, 3600.0), daemon=True)
        waiting.start()
        waiting.join(60.0)
        assert not waiting.is_alive()
    finally:
        port.close()


def test_a_port_that_nobody_else_may_hold(terminal):
    _, path = terminal
    port = Port(path, 115200, number)
    try:
        with pytest.raises(OSError, match="lock"):
            Port(path, 115200, number)
    finally:
        port.close()


def test_a_port_that_is_unplugged_says_so():
    device, host = pty.openpty()
    tty.setraw(device)
    path = os.ttyname(host)
    port = Port(path, 115200, number)
    os.close(host)
    os.close(device)
    while port.failure is None:
        port.wait(0, 1.0)
    assert port.failure
    port.close()
    assert not [t for t in threading.enumerate() if t.name == path]


def test_a_port_that_is_not_there(tmp_path):
    with pytest.raises(OSError):
        Port(str(tmp_path / "none"), 115200, number)
