"""Our own RTDE handshake: what a controller answers, and whatever else may come."""

import contextlib
import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.capture import rtde
from eitskin.capture.rtde import RtdeError, pack, robot_state

TYPES = b"DOUBLE,VECTOR6D,VECTOR6D,INT32,INT32,UINT32,UINT32"
POSE, SPEED = (-0.593, -0.201, -0.092, 0.0, 3.14, 0.0), (0.0,) * 6


def package(timestamp_s: float) -> bytes:
    values = (1, timestamp_s, *POSE, *SPEED, 7, 1, 1, 2)
    return pack(ord("U"), struct.pack(">B13d2i2I", *values))


ANSWERS = [
    pack(ord("V"), b"\x01"),
    pack(ord("v"), struct.pack(">4I", 3, 15, 8, 106339)),
    pack(ord("O"), b"\x01" + TYPES),
    pack(ord("S"), b"\x01"),
    package(10.0),
    package(10.1),
]


@pytest.fixture
def answering(monkeypatch):
    """A function: ask a controller that sends these bytes, whatever it hears, and then closes."""

    def ask(sent: bytes) -> rtde.RobotState:
        ours, theirs = socket.socketpair()
        with contextlib.closing(theirs):
            theirs.sendall(sent)
            theirs.shutdown(socket.SHUT_WR)
            monkeypatch.setattr(socket, "create_connection", lambda *_, **__: ours)
            return robot_state("a controller")

    return ask


def test_the_state_of_a_controller(answering):
    state = answering(b"".join(ANSWERS))
    assert state.version == (3, 15, 8, 106339)
    assert state.timestamp_s == 10.1
    assert state.advanced_s == pytest.approx(0.1)
    assert (state.pose, state.speed) == (POSE, SPEED)
    assert (state.robot_mode, state.safety_mode, state.safety_bits, state.runtime_state) == (
        7,
        1,
        1,
        2,
    )


def test_what_a_controller_says_to_people_is_passed_over(answering):
    packages = [part for answer in ANSWERS for part in (pack(ord("M"), b"\x05hello"), answer)]
    assert answering(b"".join(packages)).timestamp_s == 10.1


@pytest.mark.parametrize(
    ("place", "answer", "message"),
    [
        (0, pack(ord("V"), b"\x00"), "refuses version 2"),
        (2, pack(ord("O"), b"\x01" + TYPES.replace(b"INT32", b"NOT_FOUND", 1)), "NOT_FOUND"),
        (3, pack(ord("S"), b"\x00"), "does not start"),
        (3, pack(ord("P"), b"\x01"), "package 80, expected 83"),
        (4, pack(ord("U"), b"\x01"), "unpack requires"),
        (4, b"\x00\x01U", "a package of 1 bytes"),
        (5, b"", "closed the connection"),
    ],
)
def test_a_controller_that_is_unlike_rtde(answering, place, answer, message):
    with pytest.raises(RtdeError, match=message):
        answering(b"".join([*ANSWERS[:place], answer]))


@given(st.binary(max_size=400), st.integers(0, 6))
def test_whatever_comes_is_one_message(sent, n_answers):
    with pytest.MonkeyPatch.context() as patch:
        ours, theirs = socket.socketpair()
        with contextlib.closing(theirs):
            theirs.sendall(b"".join(ANSWERS[:n_answers]) + sent)
            theirs.shutdown(socket.SHUT_WR)
            patch.setattr(socket, "create_connection", lambda *_, **__: ours)
            with contextlib.suppress(RtdeError):
                assert robot_state("a controller").version == (3, 15, 8, 106339)


def test_a_controller_that_accepts_and_stays_mute(monkeypatch):
    ours, theirs = socket.socketpair()
    ours.settimeout(0.01)
    monkeypatch.setattr(socket, "create_connection", lambda *_, **__: ours)
    with contextlib.closing(theirs), pytest.raises(RtdeError, match="did not answer"):
        robot_state("a controller")
