"""An emulated serial port: a pseudo-terminal with a published link."""

import array
import asyncio
import contextlib
import errno
import fcntl
import os
import select
import termios
import time
import tty
from pathlib import Path

from rigsim.log import EventLog

PATIENCE_S = 2.0  # with a host that does not read
SETTING_UP_S = 0.5  # for a host to set the speed after opening the port
# Linux shows at most this many unread bytes of a terminal; more wait behind them.
MAX_UNREAD = 4095


class SerialPort:
    """The device's end of a serial line; a host opens `link`.

    An unplugged port has no terminal and no link; plugged in again it has another terminal.
    """

    def __init__(self, link: str | Path):
        self.link = Path(link)
        self._master: int | None = None
        self._terminal = ""
        self.plug_in()

    @property
    def plugged(self) -> bool:
        """Whether there is a terminal."""
        return self._master is not None

    def plug_in(self) -> None:
        """Make a new raw terminal and the link to it."""
        if self.plugged:
            return
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._terminal = os.ttyname(slave)
        os.close(slave)  # so that the host's own opening shows
        os.set_blocking(self._master, False)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        temporary = self.link.with_name(f".{self.link.name}.part")
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(self._terminal)
        os.replace(temporary, self.link)

    def unplug(self) -> None:
        """Pull the cable: the host's reads and writes fail."""
        if self._master is not None:
            self.link.unlink(missing_ok=True)
            os.close(self._master)
            self._master = None

    def open_by_host(self) -> bool:
        """Whether a host has the port open."""
        if self._master is None:
            return False
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return not any(events & select.POLLHUP for _, events in poll.poll(0))

    def baud(self) -> int | None:
        """The speed that the host has set; None for one that is not in termios' table."""
        assert self._master is not None
        speed = termios.tcgetattr(self._master)[5]
        names = (name for name in dir(termios) if name[0] == "B" and name[1:].isdigit())
        rates = [int(name[1:]) for name in names if getattr(termios, name) == speed]
        return rates[0] if rates else None

    def write(self, data: bytes) -> int:
        """Send without waiting; returns the number of bytes sent."""
        if self._master is None:
            return 0
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return 0  # the host has just closed it

    async def send(self, data: bytes, patience_s: float) -> int:
        """Send all, waiting for room as a device does; returns the number of bytes sent in time."""
        sent, give_up = self.write(data), time.monotonic() + patience_s
        while sent < len(data) and self.open_by_host() and time.monotonic() < give_up:
            await asyncio.sleep(0.005)
            sent += self.write(data[sent:])
        return sent

    def read(self) -> bytes:
        """The bytes that the host has sent."""
        if self._master is not None:
            with contextlib.suppress(OSError):
                return os.read(self._master, 4096)
        return b""

    def unread(self) -> int:
        """The number of bytes not yet read by the host, at most `MAX_UNREAD`, as shown by Linux."""
        terminal = os.open(self._terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            count = array.array("i", [0])
            fcntl.ioctl(terminal, termios.FIONREAD, count)
            return count[0]
        finally:
            os.close(terminal)


class Host:
    """Supervision of the host that has a port open: the speed it sets, and bytes it leaves unread
    for longer than `patience_s`."""

    def __init__(self, name: str, port: SerialPort, baud: int, log: EventLog):
        self.name, self.port, self.baud, self.log = name, port, baud, log
        self.patience_s = PATIENCE_S
        self._opened_at: float | None = None
        self._baud_seen = False
        self._full_since: float | None = None

    def listens(self) -> bool:
        """Whether the port is open; logs when that changes."""
        is_open, t = self.port.open_by_host(), time.monotonic()
        if is_open and self._opened_at is None:
            self._opened_at, self._baud_seen, self._full_since = t, False, None
            self.log.write(f"{self.name} opened")
        if not is_open and self._opened_at is not None:
            self._opened_at = None
            self.log.write(f"{self.name} closed")
        # A host opens the port before it sets the speed.
        settled = self._opened_at is not None and t - self._opened_at > SETTING_UP_S
        if settled and not self._baud_seen:
            self._baud_seen = True
            if (baud := self.port.baud()) != self.baud:
                self.log.violation(f"{self.name} baud", found=baud, expected=self.baud)
        return is_open

    def unread(self) -> int:
        """The number of bytes it has not read; logs a violation where they are too many for too
        long."""
        unread, t = self.port.unread(), time.monotonic()
        if unread < MAX_UNREAD:
            self._full_since = None
        elif self._full_since is None:
            self._full_since = t
        elif t - self._full_since > self.patience_s:
            self.log.violation("bytes never read", port=self.name)
            self._full_since = t
        return unread
