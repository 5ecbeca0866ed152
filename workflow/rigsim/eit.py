"""An EIT board of a description: text lines over a serial line, as the paper's board prints them.

The firmware (circulartest_0731.ino of knazari/eit_hybrid_state_estimation) is silent until the port
is opened, says nothing first, reads no commands, and works in a loop: a frame, its line, the next
frame.
"""

import asyncio
import time
from collections.abc import Callable

import numpy as np

from eitskin.data import board
from eitskin.data.board import CONVERSION
from rigsim.log import EventLog
from rigsim.ptys import Host, SerialPort
from rigsim.world import Press, World


def values(readings: np.ndarray, eit_board: board.Board) -> np.ndarray:
    """(P,) numbers to print: readings (M,) as the converter has them, 0 where none is measured."""
    description = eit_board.description
    numbers = np.zeros(len(eit_board.printed))
    numbers[eit_board.is_recorded] = readings / description.get("factor", 1.0)
    if eit_board.voltage != board.SIGNED:
        numbers = np.abs(numbers)
    if "step" in description:
        numbers = np.round(numbers / description["step"]) * description["step"]
    return np.clip(numbers, *description["range"])


def text(numbers: np.ndarray, eit_board: board.Board) -> bytes:
    """One line as the firmware prints it; 0 for every number that is no reading."""
    grammar = eit_board.description["line"]
    begin, end = (
        CONVERSION.sub(lambda match: match[0] % 0, grammar.get(key, "")) for key in ("begin", "end")
    )
    printed = grammar["between"].join(grammar["number"] % number for number in numbers)
    return f"{begin}{printed}{end}".encode()


class Board:
    """The board's loop. Faults set `corrupt`, from (values, line) to the bytes sent."""

    def __init__(
        self,
        config: dict,
        eit_board: board.Board,
        world: World,
        speedup: float,
        log: EventLog,
        start: float,
    ):
        self.eit_board = eit_board
        self.port = SerialPort(config["link"])
        self.host = Host("board", self.port, config["baud"], log)
        self.frame_s, self.period_s = config["frame_s"] / speedup, config["period_s"] / speedup
        self.world, self.log, self.start = world, log, start
        self.frames = 0
        self.corrupt: Callable[[np.ndarray, bytes], bytes] = lambda values, line: line

    async def warm(self) -> None:
        """Solve once in advance, which takes far longer than a frame."""
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, self.world.voltages, 0.0, self.frame_s, None)

    async def run(self) -> None:
        """Send frames while the host has the port open."""
        loop = asyncio.get_running_loop()
        while True:
            if not self.host.listens():
                await asyncio.sleep(0.02)
                continue
            if host_bytes := self.port.read():
                self.log.write("board heard", bytes=host_bytes.decode("latin-1"))
            began = time.monotonic()
            await asyncio.sleep(self.frame_s)
            ended = time.monotonic()
            start_s = began - self.start
            press = self.world.press_since(start_s, ended - self.start)
            clean = await loop.run_in_executor(
                None, self.world.voltages, start_s, ended - began, press
            )
            numbers = values(self.world.readings(clean), self.eit_board)
            await self._send(numbers, began, ended, press)
            await asyncio.sleep(max(began + self.period_s - time.monotonic(), 0.0))

    async def _send(
        self, numbers: np.ndarray, began: float, ended: float, press: Press | None
    ) -> None:
        if not self.port.open_by_host():
            return
        self.frames += 1
        line = text(numbers, self.eit_board)
        data = self.corrupt(numbers, line)
        force = 0.0 if press is None else float(press.at(np.array([ended - self.start]))[0])
        unread = self.host.unread()
        sent = await self.port.send(data, self.host.patience_s)
        self.log.write(
            "frame",
            frame=self.frames,
            began=round(began, 6),
            ended=round(ended, 6),
            force_N=round(force, 5),
            as_read=data == line,
            sent=sent,
            lost=len(data) - sent,
            unread=unread,
        )
