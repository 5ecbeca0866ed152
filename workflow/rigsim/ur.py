"""The TCP ports of a UR controller: RTDE 30004, script upload 30003, dashboard 29999."""

import asyncio
import contextlib
import re
import socket
import struct
import time
from typing import Any

from rigsim import rtde_wire as wire
from rigsim.log import EventLog
from rigsim.robot import IDLE, NORMAL, POWER_OFF, RUNNING, Controller

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
GREETING = "Connected: Universal Robots Dashboard Server"
ZERO = {kind: [0] * int(code[:-1] or 1) for kind, code in wire.FORMATS.items()}


class ProtocolError(Exception):
    """A client that breaks the protocol; its connection is closed."""


class RtdeServer:
    """RTDE v2 for any number of clients.

    muted: new connections and packages get no answer; stalled: data packages stop, TCP stays.
    """

    def __init__(self, controller: Controller, log: EventLog):
        self.controller, self.log = controller, log
        self.clients: set[RtdeClient] = set()
        self.owners: dict[str, object] = {}
        self.muted = self.stalled = False

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, until it ends."""
        client = RtdeClient(self, reader, writer)
        self.clients.add(client)
        try:
            await client.talk()
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        except ProtocolError as error:
            self.log.violation("RTDE protocol", reason=str(error))
        finally:
            client.close()
            self.clients.discard(client)
            for name in [name for name, owner in self.owners.items() if owner is client]:
                del self.owners[name]

    def claim_all(self, owner: object) -> None:
        """Give `owner` every input register that has no owner."""
        for name in wire.INPUTS:
            self.owners.setdefault(name, owner)

    def release_all(self, owner: object) -> None:
        """Release all registers of `owner`."""
        for name in [name for name, current_owner in self.owners.items() if current_owner is owner]:
            del self.owners[name]

    def reset(self) -> None:
        """End every connection as by a broken cable."""
        for client in list(self.clients):
            client.close()


class RtdeClient:
    """One connection; the order of its requests is checked."""

    def __init__(
        self, server: RtdeServer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ):
        self.server, self.reader, self.writer = server, reader, writer
        self.version: int | None = None
        self.outputs: tuple[struct.Struct, list[list[int]]] | None = None
        self.names: list[str] = []
        self.inputs: dict[int, tuple[list[str], struct.Struct]] = {}
        self.frequency = 0.0
        self.streaming: asyncio.Task | None = None
        self.peer = writer.get_extra_info("peername")[1]

    async def talk(self) -> None:
        """Answer packages until the connection ends."""
        log = self.server.log
        log.write("rtde connected", client=self.peer)
        sock = self.writer.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        answers = {
            wire.REQUEST_PROTOCOL_VERSION: self._protocol_version,
            wire.GET_URCONTROL_VERSION: self._controller_version,
            wire.SETUP_OUTPUTS: self._setup_outputs,
            wire.SETUP_INPUTS: self._setup_inputs,
            wire.START: self._start,
            wire.PAUSE: self._pause,
        }
        try:
            while True:
                size, command = wire.HEADER.unpack(await self.reader.readexactly(wire.HEADER.size))
                if size < wire.HEADER.size:
                    raise ProtocolError(f"package size {size}, at least {wire.HEADER.size}")
                payload = await self.reader.readexactly(size - wire.HEADER.size)
                if self.server.muted:
                    continue
                if command == wire.DATA_PACKAGE:
                    self._data(payload)
                elif command == wire.TEXT_MESSAGE:
                    log.write("rtde message", text=payload.decode("latin-1"))
                elif command in answers:
                    if command != wire.REQUEST_PROTOCOL_VERSION and self.version is None:
                        raise ProtocolError(f"{chr(command)!r} before the protocol version")
                    self.writer.write(wire.package(command, answers[command](payload)))
                else:
                    raise ProtocolError(f"unknown package {command}")
        finally:
            log.write("rtde gone", client=self.peer)

    def close(self) -> None:
        """End the connection at once, with a reset."""
        if self.streaming is not None:
            self.streaming.cancel()
        sock = self.writer.get_extra_info("socket")
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.writer.transport.abort()

    def _protocol_version(self, payload: bytes) -> bytes:
        (version,) = _unpack(">H", payload, "protocol version")
        if version == 2:
            self.version = version
        return bytes([version == 2])

    def _controller_version(self, payload: bytes) -> bytes:
        _unpack("", payload, "controller version")
        return struct.pack(">4I", *self.server.controller.series.version)

    def _variable_types(self, text: bytes, table: dict[str, str]) -> tuple[list[str], list[str]]:
        if len(text) > wire.MAX_NAMES:
            raise ProtocolError(f"{len(text)} bytes of names, at most {wire.MAX_NAMES}")
        names = text.decode("latin-1").rstrip(",").split(",")
        version = self.server.controller.series.version
        types = [wire.type_of(name, table, version) or "NOT_FOUND" for name in names]
        unknown = [n for n, kind in zip(names, types, strict=True) if kind == "NOT_FOUND"]
        if unknown:
            self.server.log.write("rtde not found", names=unknown)
        return names, types

    def _setup_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise ProtocolError(f"outputs of {len(payload)} bytes, at least a frequency")
        (frequency,) = struct.unpack_from(">d", payload)
        max_frequency = self.server.controller.series.cycle_Hz
        if not 0 < frequency <= max_frequency:
            raise ProtocolError(f"frequency {frequency}, above 0 to {max_frequency}")
        names, types = self._variable_types(payload[8:], wire.OUTPUTS)
        if "NOT_FOUND" not in types:
            self.names, self.frequency = names, frequency
            self.outputs = wire.recipe(types), [ZERO[kind] for kind in types]
            robot = self.server.controller
            self.registers = {
                name: ((robot.int_out if "int" in name else robot.double_out), int(match[1]))
                for name in names
                if (match := re.search(r"^output_(?:int|double)_register_(\d+)$", name))
            }
        return b"\x01" + ",".join(types).encode()

    def _setup_inputs(self, payload: bytes) -> bytes:
        names, types = self._variable_types(payload, wire.INPUTS)
        owners = self.server.owners
        for k, name in enumerate(names):
            if types[k] != "NOT_FOUND" and owners.get(name, self) is not self:
                types[k] = "IN_USE"
        if {"NOT_FOUND", "IN_USE"} & set(types):
            if "IN_USE" in types:
                self.server.log.write("rtde in use", client=self.peer)
            return b"\x00" + ",".join(types).encode()
        for name in names:
            owners[name] = self
        number = len(self.inputs) + 1
        self.inputs[number] = (names, wire.recipe(types))
        return bytes([number]) + ",".join(types).encode()

    def _start(self, payload: bytes) -> bytes:
        _unpack("", payload, "start")
        if self.outputs is None and not self.inputs:
            raise ProtocolError("start before outputs or inputs")
        if self.outputs is not None and self.streaming is None:
            self.streaming = asyncio.create_task(self._stream())
        return b"\x01"

    def _pause(self, payload: bytes) -> bytes:
        _unpack("", payload, "pause")
        if self.streaming is not None:
            self.streaming.cancel()
            self.streaming = None
        return b"\x01"

    def _data(self, payload: bytes) -> None:
        if not payload or payload[0] not in self.inputs:
            raise ProtocolError(f"data of recipe {payload[:1].hex() or 'none'}, never set up")
        names, recipe = self.inputs[payload[0]]
        if len(payload) != recipe.size:
            raise ProtocolError(f"{len(payload)} bytes of recipe {payload[0]}, {recipe.size}")
        values = list(recipe.unpack(payload)[1:])
        inputs: dict[str, Any] = {}
        for name in names:
            width = len(ZERO[wire.INPUTS[name]])
            inputs[name] = values[0] if width == 1 else values[:width]
            del values[:width]
        self.server.controller.receive(inputs)

    async def _stream(self) -> None:
        period = 1.0 / self.frequency
        assert self.outputs is not None
        recipe, zeros = self.outputs
        due = time.monotonic()
        with contextlib.suppress(ConnectionError):
            while True:
                if not self.server.stalled:
                    outputs = self.server.controller.outputs()
                    outputs |= {
                        name: register_values[k]
                        for name, (register_values, k) in self.registers.items()
                    }
                    flat: list[float] = [1]
                    for name, zero in zip(self.names, zeros, strict=True):
                        value = outputs.get(name, zero)
                        flat += value if isinstance(value, list) else [value]
                    self.writer.write(wire.package(wire.DATA_PACKAGE, recipe.pack(*flat)))
                    await self.writer.drain()
                due = max(due + period, time.monotonic())
                await asyncio.sleep(due - time.monotonic())


def _unpack(form: str, payload: bytes, package_name: str) -> tuple:
    if struct.calcsize(form) != len(payload):
        raise ProtocolError(f"{package_name} of {len(payload)} bytes, {struct.calcsize(form)}")
    return struct.unpack(form, payload)


class ScriptServer:
    """The port for uploaded programs, which are run once complete."""

    def __init__(self, controller: Controller):
        self.controller = controller

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection; a program ends with a line `end` in the first column."""
        text = b""
        try:
            while data := await reader.read(1 << 16):
                text += data
                while (end := _program_end(text)) is not None:
                    self.controller.start(text[:end])
                    text = text[end:]
            if text.strip():
                self.controller.log.violation("script complete", bytes=len(text))
        except ConnectionError:
            pass
        finally:
            writer.close()


def _program_end(text: bytes) -> int | None:
    position = text.find(b"\nend\n")
    return None if position < 0 else position + len(b"\nend\n")


class DashboardServer:
    """Universal Robots' dashboard server: one answer for each line."""

    def __init__(self, controller: Controller, log: EventLog):
        self.controller, self.log = controller, log

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, until it ends or sends quit."""
        writer.write(f"{GREETING}\n".encode())
        try:
            while line := await reader.readline():
                command = line.decode("latin-1").strip()
                answer = self.answer(command)
                writer.write(f"{answer}\n".encode())
                await writer.drain()
                if command == "quit":
                    break
        except ConnectionError:
            pass
        finally:
            writer.close()

    def answer(self, command: str) -> str:
        """Carry out one command; returns the answer."""
        robot = self.controller
        self.log.write("dashboard", command=command)
        modes = {POWER_OFF: "POWER_OFF", IDLE: "IDLE", RUNNING: "RUNNING"}
        safety = {1: "NORMAL", 3: "PROTECTIVE_STOP", 7: "ROBOT_EMERGENCY_STOP"}
        texts = {
            "PolyscopeVersion": robot.series.polyscope,
            "get serial number": robot.series.serial,
            "get robot model": robot.series.model,
            "robotmode": f"Robotmode: {modes[robot.robot_mode]}",
            "safetymode": f"Safetymode: {safety[robot.safety_mode]}",
            "safetystatus": f"Safetystatus: {safety[robot.safety_mode]}",
            "running": f"Program running: {str(robot.playing).lower()}",
            "programState": ("PLAYING" if robot.playing else "STOPPED") + " rtde_control",
            "close safety popup": "closing safety popup",
            "close popup": "closing popup",
            "quit": "Disconnected",
        }
        if robot.series.version[0] >= 5:
            texts["is in remote control"] = "true"
        if command in texts:
            return texts[command]
        if command == "stop":
            if not robot.playing:
                return "Failed to execute: stop"
            robot.log_motion("stopping")
            robot.stop_program("dashboard")
            return "Stopped"
        if command == "unlock protective stop":
            unlocked = robot.unlock()
            early = "Cannot unlock protective stop until 5s after occurrence"
            return "Protective stop releasing" if unlocked else early
        if command == "power on" and robot.safety_mode == NORMAL:
            robot.robot_mode = max(robot.robot_mode, IDLE)
            return "Powering on"
        if command == "brake release" and robot.safety_mode == NORMAL:
            robot.robot_mode = RUNNING
            return "Brake releasing"
        return f"could not understand: '{command}'"
