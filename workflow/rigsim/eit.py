"""The paper's EIT board: text lines of 256 RMS values over a serial line.

Source: circulartest_0731.ino of knazari/eit_hybrid_state_estimation. The firmware is silent until
the port is opened, says nothing first, reads no commands, and works in a loop: a frame, its line,
the next frame.
"""

import asyncio
import time
from collections.abc import Callable

import numpy as np

from rigsim.log import EventLog
from rigsim.ptys import Host, SerialPort
from rigsim.world import N_ELECTRODES, Press, World

STEP_V = 2.2 / 1024  # of the board's 10-bit converter with 2.2 V
MAX_V = 1.1  # RMS, half of the converter's range


def quantised(reading_V: np.ndarray) -> np.ndarray:
    """RMS values (M,) V rounded and clipped as by the converter."""
    return np.clip(np.round(reading_V / STEP_V) * STEP_V, 0.0, MAX_V)


def values(reading_V: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """(256,) V, drive-major: the readings (208,) and 0 where a pair touches a driven electrode."""
    line = np.zeros(N_ELECTRODES**2)
    line[N_ELECTRODES * channels[:, 0] + channels[:, 2]] = quantised(reading_V)
    return line


def text(line_V: np.ndarray) -> bytes:
    """One line as the firmware prints it."""
    return "".join(f"{value:.4f}, " for value in line_V).encode() + b"\n"


class Board:
    """The board's loop. Faults set `corrupt`, from (values, line) to the bytes sent."""

    def __init__(self, config: dict, world: World, speedup: float, log: EventLog, start: float):
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
            line_V = values(self.world.readings(clean), self.world.channels)
            await self._send(line_V, began, ended, press)
            await asyncio.sleep(max(began + self.period_s - time.monotonic(), 0.0))

    async def _send(
        self, line_V: np.ndarray, began: float, ended: float, press: Press | None
    ) -> None:
        if not self.port.open_by_host():
            return
        self.frames += 1
        data = self.corrupt(line_V, text(line_V))
        force = 0.0 if press is None else float(press.at(np.array([ended - self.start]))[0])
        unread = self.host.unread()
        sent = await self.port.send(data, self.host.patience_s)
        self.log.write(
            "frame",
            frame=self.frames,
            began=round(began, 6),
            ended=round(ended, 6),
            force_N=round(force, 5),
            as_read=data == text(line_V),
            sent=sent,
            lost=len(data) - sent,
            unread=unread,
        )
