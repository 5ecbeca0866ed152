"""The parts of the emulated rig and the world's clock."""

import asyncio
import json
import signal
import socket
import sys
import time

import numpy as np

from eitskin.data import board
from eitskin.errors import InputError
from rigsim.config import read_fault
from rigsim.eit import Board
from rigsim.faults import Faults, Parts
from rigsim.load import PROFILES
from rigsim.log import EventLog
from rigsim.robot import Controller
from rigsim.ur import (
    DASHBOARD_PORT,
    RTDE_PORT,
    SCRIPT_PORT,
    DashboardServer,
    RtdeServer,
    ScriptServer,
)
from rigsim.world import DRAG_MM, World

RULES_BROKEN = 3  # exit code
PROFILE = "circular-16"  # the board where none is named


class Rig:
    """The emulated rig of a configuration; its ports open in `run`."""

    def __init__(self, config: dict):
        self.config = config
        self.log = EventLog(config["log"])
        self.start = time.monotonic()
        eit_board = board.read(config["board"].get("profile", PROFILE), "rigsim", "board.profile")
        self.world = World(config["world"], eit_board.channels, config["seed"])
        speedup, rules = config["speedup"], config["rules"]
        pose = config["robot"]["pose"]
        self.robot = Controller(config["series"], pose, speedup, rules, self.log)
        self.robot.force_entry = self.world.force_entry
        self.board = Board(config["board"], eit_board, self.world, speedup, self.log, self.start)
        cell = config["load_cell"]
        self.cell = PROFILES[cell["profile"]](cell, self.world, speedup, self.log, config["seed"])
        self.rtde = RtdeServer(self.robot, self.log)
        parts = Parts(self.world, self.robot, self.rtde, self.board, self.cell)
        self.faults = Faults(parts, self.log, self._refuse_rtde, config["seed"], self.start)
        self.faults.pending = list(config["faults"])
        self._reported_rules: set[str] = set()
        self._stopping = asyncio.Event()
        self._bug: BaseException | None = None
        self._listening: dict[int, asyncio.Server] = {}
        self._reopening: asyncio.Task | None = None

    async def run(self) -> int:
        """Listen, print the endpoints, and run until standard input ends or a signal comes.

        The exit code: 0, or RULES_BROKEN where the driver broke a rule.
        """
        host = self.config["host"]
        self.log.write("start", config=self.config)
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._stopping.set)
        loop.set_exception_handler(self._broken)
        await self.board.warm()
        servers = {
            RTDE_PORT: self.rtde.serve,
            SCRIPT_PORT: ScriptServer(self.robot).serve,
            DASHBOARD_PORT: DashboardServer(self.robot, self.log).serve,
        }
        for port, serve in servers.items():
            self._listening[port] = await asyncio.start_server(serve, host, port)
        parts = [self._tick(), self._control(), self.board.run(), self.cell.run()]
        tasks = [asyncio.create_task(part) for part in parts]
        endpoints = {
            "robot_host": host,
            "dashboard_port": DASHBOARD_PORT,
            "board": str(self.board.port.link),
            "load_cell": str(self.cell.port.link),
            "log": str(self.log.path),
        }
        print(json.dumps(endpoints), flush=True)
        stop_task = asyncio.create_task(self._stopping.wait())
        done, _ = await asyncio.wait([stop_task, *tasks], return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        self.board.port.unplug()
        self.cell.port.unplug()
        self.log.write("end", violations=self.log.violations, **self.world.force_entry())
        for task_done in done - {stop_task}:
            task_done.result()
        if self._bug is not None:
            raise self._bug
        return RULES_BROKEN if self.log.violations else 0

    def _broken(self, loop: asyncio.AbstractEventLoop, context: dict) -> None:
        """Stop on an exception of the emulator itself, so that no test continues."""
        error = context.get("exception")
        if error is None or isinstance(error, ConnectionError):
            loop.default_exception_handler(context)
            return
        self._bug = error
        self._stopping.set()

    async def _tick(self) -> None:
        """The world's clock: the controller's cycle."""
        period = 1.0 / self.robot.series.cycle_Hz
        due = previous = time.monotonic()
        while True:
            t = time.monotonic()
            self.robot.tick(t - previous)
            previous = t
            self._step(t)
            due = max(due + period, t)
            await asyncio.sleep(due - time.monotonic())

    def _step(self, t: float) -> None:
        pose = self.robot.pose
        met = self.world.follow(pose, t - self.start)
        self.robot.tcp_force_N = self.world.force_N
        if met is not None:
            x, y = self.world.on_skin_mm(pose)
            self.log.write(
                met,
                contact=self.world.contacts,
                x_mm=round(x, 4),
                y_mm=round(y, 4),
                probe_mm=self.world.probe_mm(),
                **self.world.force_entry(),
            )
        self._check_world(pose)
        self.faults.tick(t)

    def _check_world(self, pose: np.ndarray) -> None:
        """Log the rules broken in the world, each once a press."""
        world, hard_N = self.world, self.config["rules"]["hard_N"]
        if not world.touching:
            self._reported_rules.clear()
            return
        x, y = world.on_skin_mm(pose)
        broken = {
            "hard_N": hard_N is not None and world.force_N > hard_N,
            "no dragging": world.dragged_mm > DRAG_MM,
            "tool straight down": world.tool_leans(pose),
            "presses on the skin": x * x + y * y > world.radius_mm**2,
        }
        for rule, is_broken in broken.items():
            if is_broken and rule not in self._reported_rules:
                self._reported_rules.add(rule)
                self.log.violation(rule, force_N=round(world.force_N, 4), x_mm=x, y_mm=y)

    async def _control(self) -> None:
        """Read faults from standard input; stop at its end, the parent's."""
        loop = asyncio.get_running_loop()
        reader = asyncio.StreamReader()
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            try:
                self.faults.pending.append(read_fault(line.decode()))
            except InputError as error:
                self.log.write("control refused", reason=str(error))
                print(error, file=sys.stderr, flush=True)
        self._stopping.set()

    def _refuse_rtde(self, refused: bool) -> None:
        """Stop or start listening for RTDE."""
        if refused:
            self._listening[RTDE_PORT].close()
            return
        # Clients may connect from here on; they are served once the loop comes to it.
        listener = socket.create_server((self.config["host"], RTDE_PORT))

        async def serve() -> None:
            server = await asyncio.start_server(self.rtde.serve, sock=listener)
            self._listening[RTDE_PORT] = server

        self._reopening = asyncio.get_running_loop().create_task(serve())
