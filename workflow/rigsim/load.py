"""Load cells: one force a line over a serial line.

The paper's, an Arduino with an HX711 (force_sensor.ino of knazari/eit_hybrid_state_estimation),
and SparkFun's OpenScale (firmware v1.2). Opening the port resets either.
"""

import asyncio
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from rigsim.log import EventLog
from rigsim.ptys import Host, SerialPort
from rigsim.world import World

BANNER = b"Load cell ready. Readings in Newtons (N):\r\n"
TARE_READINGS = 10
MEAN_OF = 4
HEADER = b"\r\nSerial Load Cell Converter version 1.2\r\nBy SparkFun Electronics\r\n"
KG, LBS = ("kg", 9.80665), ("lbs", 4.4482216)  # name, N of one
MENU = b"\r\n1) Tare scale\r\nx) Exit\r\n>"
ROOM_C = 24.75
BOOT_S = 0.2  # of which no speedup makes less: a host that opens a port empties it first


class LoadCell:
    """The paper's sketch: it tares over 10 readings, says its banner, then prints, after each
    reading, the mean of up to 4.

    Faults change what the cell feels (`felt`, N) and what it says (`said`; None: nothing), or
    reset it (`resets`).
    """

    def __init__(self, config: dict, world: World, speedup: float, log: EventLog, seed: int):
        self.port = SerialPort(config["link"])
        self.host = Host("load cell", self.port, config["baud"], log)
        self.period_s = 1.0 / (config["rate_Hz"] * speedup)
        self.noise_N = config["noise_N"]
        self.world, self.log = world, log
        self.rng = np.random.default_rng([seed, 3])
        self.felt: Callable[[float], float] = lambda force: force
        self.said: Callable[[bytes], bytes | None] = lambda line: line
        self.resets = False
        self.zero_N = 0.0
        self.recent: deque[float] = deque(maxlen=MEAN_OF)

    def reading(self) -> float:
        """One reading of the bridge, N."""
        return self.felt(self.world.force_N) + self.noise_N * self.rng.standard_normal()

    async def run(self) -> None:
        """Reset whenever the host opens the port; then reading after reading."""
        while True:
            if not self.host.listens():
                await asyncio.sleep(0.02)
                continue
            self.resets = True
            due = time.monotonic()
            while self.host.listens():
                if self.resets:
                    self.resets = False
                    await self.setup()
                due = max(due + self.period_s, time.monotonic())
                await asyncio.sleep(due - time.monotonic())
                await self.loop()

    async def setup(self) -> None:
        """What the device does after a reset."""
        self.recent.clear()
        await self.tare()
        self.say(BANNER)

    async def tare(self) -> None:
        """Take what it feels now for zero."""
        taken = []
        for _ in range(TARE_READINGS):
            await asyncio.sleep(self.period_s)
            taken.append(self.reading())
        self.zero_N = float(np.mean(taken))
        self.log.write("load cell tared", zero_N=round(self.zero_N, 5))

    async def loop(self) -> None:
        """What it does once a reading."""
        self.recent.append(self.reading() - self.zero_N)
        self.say(f"{np.mean(self.recent):.4f}\r\n".encode())
        if heard := self.port.read():
            self.log.write("load cell heard", bytes=heard.decode("latin-1"))

    def say(self, line: bytes) -> None:
        """Print, or what a fault makes of it."""
        data = self.said(line)
        if data and self.port.open_by_host():
            self.host.unread()
            self.port.write(data)


class OpenScale(LoadCell):
    """`ms,reading,unit,temperature,` lines in kg with 4 decimals (its default is lbs with 2).

    It keeps its zero through a reset. `x` opens a menu, in which it is silent, `1` tares there,
    `x` leaves.
    """

    unit = KG
    in_menu = False
    began = 0.0

    async def setup(self) -> None:
        """Its header, once it has booted."""
        await asyncio.sleep(BOOT_S)
        self.began, self.in_menu = time.monotonic(), False
        self.say(HEADER)

    async def loop(self) -> None:
        """A line, unless it is in its menu."""
        for key in self.port.read().decode("latin-1"):
            self.log.write("load cell heard", bytes=key)
            if key == "x":
                self.in_menu = not self.in_menu
                self.say(MENU if self.in_menu else b"\r\nExiting\r\n")
            elif key == "1" and self.in_menu:
                await self.tare()
                self.say(MENU)
        force = self.reading() - self.zero_N
        if not self.in_menu:
            name, newtons = self.unit
            ms = round(1e3 * (time.monotonic() - self.began))
            self.say(f"{ms},{force / newtons:.4f},{name},{ROOM_C:.2f},\r\n".encode())


PROFILES = {"hx711": LoadCell, "openscale": OpenScale}
