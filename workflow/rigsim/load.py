"""Load cells: one force in each line over a serial port.

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
TARE_READINGS = 10  # of the paper's sketch
MEAN_LENGTH = 4  # of the paper's sketch
HEADER = b"\r\nSerial Load Cell Converter version 1.2\r\nBy SparkFun Electronics\r\n"
KG, LBS = ("kg", 9.80665), ("lbs", 4.4482216)  # name, N of one
MENU = b"\r\n1) Tare scale\r\nx) Exit\r\n>"
ROOM_C = 24.75  # a usual temperature of the OpenScale
BOOT_S = 0.2  # independent of the speedup: a host that opens a port empties it first


class LoadCell:
    """The paper's sketch: it tares over 10 readings, prints its banner, then prints the mean of up
    to 4 readings after each.

    Faults change the force (`force_fault`, N) and the line (`line_fault`; None: no line), or reset
    the cell (`resets`).
    """

    def __init__(self, config: dict, world: World, speedup: float, log: EventLog, seed: int):
        self.port = SerialPort(config["link"])
        self.host = Host("load cell", self.port, config["baud"], log)
        self.period_s = 1.0 / (config["rate_Hz"] * speedup)
        self.noise_N = config["noise_N"]
        self.world, self.log = world, log
        self.rng = np.random.default_rng([seed, 3])
        self.force_fault: Callable[[float], float] = lambda force: force
        self.line_fault: Callable[[bytes], bytes | None] = lambda line: line
        self.resets = False
        self.zero_N = 0.0
        self.recent: deque[float] = deque(maxlen=MEAN_LENGTH)

    def reading(self) -> float:
        """One reading of the bridge, N."""
        return self.force_fault(self.world.force_N) + self.noise_N * self.rng.standard_normal()

    async def run(self) -> None:
        """Reset whenever the host opens the port, then print readings."""
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
        """The device's actions after a reset."""
        self.recent.clear()
        await self.tare()
        self.say(BANNER)

    async def tare(self) -> None:
        """Set zero to the present force."""
        readings = []
        for _ in range(TARE_READINGS):
            await asyncio.sleep(self.period_s)
            readings.append(self.reading())
        self.zero_N = float(np.mean(readings))
        self.log.write("load cell tared", zero_N=round(self.zero_N, 5))

    async def loop(self) -> None:
        """The device's actions for each reading."""
        self.recent.append(self.reading() - self.zero_N)
        self.say(f"{np.mean(self.recent):.4f}\r\n".encode())
        if host_bytes := self.port.read():
            self.log.write("load cell heard", bytes=host_bytes.decode("latin-1"))

    def say(self, line: bytes) -> None:
        """Print a line, as changed by a fault."""
        data = self.line_fault(line)
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
        """Print the header after booting."""
        await asyncio.sleep(BOOT_S)
        self.began, self.in_menu = time.monotonic(), False
        self.say(HEADER)

    async def loop(self) -> None:
        """Handle the host's keys and print a line, unless in the menu."""
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
