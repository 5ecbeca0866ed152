"""The paper's load cell: an Arduino with an HX711, one force in newtons a line.

Source: force_sensor.ino of knazari/eit_hybrid_state_estimation. Opening the port resets the
Arduino: it tares over 10 readings, says its banner, then prints the mean of up to 4 readings.
"""

import asyncio
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from rigsim.log import EventLog
from rigsim.ptys import SerialPort
from rigsim.world import World

BANNER = b"Load cell ready. Readings in Newtons (N):\r\n"
TARE_READINGS = 10
MEAN_OF = 4


class LoadCell:
    """The sketch's loop. Faults change what the cell feels (`felt`) and what it says (`said`);
    said returns None where nothing comes."""

    def __init__(self, config: dict, world: World, speedup: float, log: EventLog, seed: int):
        self.port = SerialPort(config["link"])
        self.baud, self.period_s = config["baud"], 1.0 / (config["rate_Hz"] * speedup)
        self.noise_N = config["noise_N"]
        self.world, self.log = world, log
        self.rng = np.random.default_rng([seed, 3])
        self.felt: Callable[[float], float] = lambda force: force
        self.said: Callable[[bytes], bytes | None] = lambda line: line

    def reading(self) -> float:
        """One reading of the bridge, N."""
        return self.felt(self.world.force_N) + self.noise_N * self.rng.standard_normal()

    async def run(self) -> None:
        """Reset whenever the host opens the port; then reading after reading."""
        while True:
            if not self.port.open_by_host():
                await asyncio.sleep(0.02)
                continue
            await self._setup()
            await self._loop()
            self.log.write("load cell closed")

    async def _setup(self) -> None:
        baud = self.port.baud()
        self.log.write("load cell opened", baud=baud)
        if baud != self.baud:
            self.log.violation("load cell baud", found=baud, expected=self.baud)
        taken = []
        for _ in range(TARE_READINGS):
            await asyncio.sleep(self.period_s)
            taken.append(self.reading())
        self.zero_N = float(np.mean(taken))
        self.log.write("load cell tared", zero_N=round(self.zero_N, 5))
        self._say(BANNER)

    async def _loop(self) -> None:
        recent: deque[float] = deque(maxlen=MEAN_OF)
        due = time.monotonic()
        while self.port.open_by_host():
            due = max(due + self.period_s, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
            recent.append(self.reading() - self.zero_N)
            self._say(f"{np.mean(recent):.4f}\r\n".encode())
            if heard := self.port.read():
                self.log.write("load cell heard", bytes=heard.decode("latin-1"))

    def _say(self, line: bytes) -> None:
        data = self.said(line)
        if data and self.port.open_by_host():
            self.port.write(data)
