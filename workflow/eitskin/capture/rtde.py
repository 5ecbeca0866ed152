"""The robot's state by a plain RTDE connection, before any library may move it.

The library's constructors wait for ever for a controller that accepts and stays mute; here every
read has a deadline. Wire format: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

import contextlib
import socket
import struct
from dataclasses import dataclass
from typing import BinaryIO

PORT = 30004
TIMEOUT_S = 2.0  # for one package over a local network
PROTOCOL_VERSION = 2  # with the output frequency in the request
VERSION, CONTROLLER, OUTPUTS, START, TEXT, DATA = b"VvOSMU"
HEADER = struct.Struct(">HB")
VARIABLES = {
    "timestamp": ("DOUBLE", "d"),
    "actual_TCP_pose": ("VECTOR6D", "6d"),
    "actual_TCP_speed": ("VECTOR6D", "6d"),
    "robot_mode": ("INT32", "i"),
    "safety_mode": ("INT32", "i"),
    "safety_status_bits": ("UINT32", "I"),
    "runtime_state": ("UINT32", "I"),
}
RATE_HZ = 10.0  # two packages are needed


@dataclass(frozen=True)
class RobotState:
    """A controller's version, and its state in the second of two packages (base frame, m)."""

    version: tuple[int, int, int, int]
    timestamp_s: float
    advanced_s: float  # of its clock, from the first package to the last
    pose: tuple[float, ...]
    speed: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    safety_bits: int
    runtime_state: int


class RtdeError(Exception):
    """A controller without a usable RTDE connection; its text is for a person."""


def pack(command: int, payload: bytes = b"") -> bytes:
    """One RTDE package."""
    return HEADER.pack(HEADER.size + len(payload), command) + payload


def robot_state(host: str) -> RobotState:
    """The state of the controller at `host`; raises RtdeError where it is absent, mute or speaks
    another protocol."""
    try:
        with socket.create_connection((host, PORT), timeout=TIMEOUT_S) as connection:
            return _request_state(connection)
    except TimeoutError as error:
        raise RtdeError(f"{host}:{PORT} did not answer within {TIMEOUT_S:g} s") from error
    except (OSError, struct.error) as error:
        raise RtdeError(f"{host}:{PORT}: {error}") from error


def _request_state(connection: socket.socket) -> RobotState:
    stream = connection.makefile("rb")
    with contextlib.closing(stream):
        acceptance = _reply(connection, stream, VERSION, struct.pack(">H", PROTOCOL_VERSION))
        if acceptance != b"\x01":
            raise RtdeError("the controller refuses version 2 of RTDE")
        version = struct.unpack(">4I", _reply(connection, stream, CONTROLLER))
        names = ",".join(VARIABLES)
        offer = _reply(connection, stream, OUTPUTS, struct.pack(">d", RATE_HZ) + names.encode())
        expected_types = ",".join(kind for kind, _ in VARIABLES.values())
        if offer[1:].decode(errors="replace") != expected_types:
            raise RtdeError(f"the controller offers {offer[1:]!r} for {names}")
        if _reply(connection, stream, START) != b"\x01":
            raise RtdeError("the controller does not start sending its state")
        first_package = _unpack(_read_package(stream, DATA))
        last_package = _unpack(_read_package(stream, DATA))
    pose, speed = last_package[1:7], last_package[7:13]
    return RobotState(
        version,
        last_package[0],
        last_package[0] - first_package[0],
        pose,
        speed,
        *last_package[13:],
    )


def _unpack(payload: bytes) -> tuple:
    layout = ">B" + "".join(code for _, code in VARIABLES.values())
    return struct.unpack(layout, payload)[1:]


def _reply(
    connection: socket.socket, stream: BinaryIO, command: int, payload: bytes = b""
) -> bytes:
    connection.sendall(pack(command, payload))
    return _read_package(stream, command)


def _read_package(stream: BinaryIO, command: int) -> bytes:
    """The payload of the next package of kind `command`; text messages are skipped."""
    while True:
        size, kind = HEADER.unpack(_read_exactly(stream, HEADER.size))
        if size < HEADER.size:
            raise RtdeError(f"a package of {size} bytes")
        payload = _read_exactly(stream, size - HEADER.size)
        if kind == command:
            return payload
        if kind not in (TEXT, DATA):
            raise RtdeError(f"package {kind}, expected {command}")


def _read_exactly(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise RtdeError("the controller closed the connection")
    return data
