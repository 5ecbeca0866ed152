"""Whole lines off a serial port, each with the moment at which it and the one before it ended."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import serial

from eitskin.capture.wire import Reject

Value = TypeVar("Value")

LONGEST_LINE = 65536  # bytes; more without an end is noise
KEPT_LINES = 4096
READ_S = 0.02


@dataclass(frozen=True)
class Line(Generic[Value]):
    """One line: its bytes, what they say, and when it ended on the host's monotonic clock (s).

    `before_s` is the end of the line before, `before_ok` whether that one was a reading.
    """

    number: int
    raw: bytes
    value: Value | Reject
    end_s: float
    before_s: float
    before_ok: bool

    @property
    def ok(self) -> bool:
        """Whether it is a reading."""
        return not isinstance(self.value, Reject)


class Splitter(Generic[Value]):
    """Bytes as they come, to lines. What stands before the first newline is nobody's line: it
    began before the port was opened, and may be stale bytes joined to a frame."""

    def __init__(self, parse: Callable[[bytes], Value | Reject]):
        self._parse = parse
        self._pending = b""
        self._number = 0
        self._before: tuple[float, bool] | None = None  # end of the last line, whether a reading

    def feed(self, chunk: bytes, now_s: float) -> list[Line[Value]]:
        """The lines that `chunk`, read at `now_s`, completes."""
        *whole, self._pending = (self._pending + chunk).split(b"\n")
        lines = []
        for part in whole:
            if self._before is None:
                self._before = (now_s, False)
                continue
            value = self._parse(part + b"\n")
            lines.append(self._line(part + b"\n", value, now_s, self._before))
        if len(self._pending) > LONGEST_LINE:
            if self._before is not None:
                value = Reject("endless", f"{len(self._pending)} bytes without a newline")
                lines.append(self._line(self._pending, value, now_s, self._before))
            self._pending, self._before = b"", None
        return lines

    def _line(
        self, raw: bytes, value: Value | Reject, now_s: float, before: tuple[float, bool]
    ) -> Line[Value]:
        self._number += 1
        line = Line(self._number, raw, value, now_s, *before)
        self._before = (now_s, line.ok)
        return line


def plausible_s(period_s: float) -> tuple[float, float]:
    """The shortest and the longest time (s) from line to line of a board of this period."""
    return 0.5 * period_s, 1.75 * period_s + 0.05


def began_after(line: Line, moment_s: float, period_s: float) -> bool:
    """Whether a board's frame is whole and surely began after `moment_s`.

    A board prints a frame once it is complete and then begins the next: this one began at the
    earliest when the line before it ended. That line must be a frame too, or its end may be a stray
    newline. Two lines much closer than the board's period were waiting in a buffer, so their times
    are the host's; two much farther apart may be the halves of two frames.
    """
    if not line.ok or not line.before_ok or line.before_s < moment_s:
        return False
    shortest_s, longest_s = plausible_s(period_s)
    return shortest_s <= line.end_s - line.before_s <= longest_s


class Port(Generic[Value]):
    """A serial port read by a thread of its own until it is closed.

    Raises OSError (a SerialException is one) where the port cannot be opened. A port that vanishes
    later ends the thread: `lost` then says why.
    """

    def __init__(
        self,
        device: str,
        baud: int,
        parse: Callable[[bytes], Value | Reject],
        start: bytes = b"",
        clock: Callable[[], float] = time.monotonic,
    ):
        self.device = device
        self.lost: str | None = None
        self._clock = clock
        self._splitter = Splitter(parse)
        self._lines: deque[Line[Value]] = deque(maxlen=KEPT_LINES)
        self._changed = threading.Condition()
        self._closing = False
        self._serial = serial.Serial(device, baud, timeout=READ_S, exclusive=True)
        if start:
            self._serial.write(start)
        self._thread = threading.Thread(target=self._read, name=device, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._closing:
            try:
                chunk = self._serial.read(max(1, self._serial.in_waiting))
            except (OSError, TypeError) as error:  # TypeError: closed by another thread in a read
                with self._changed:
                    self.lost = str(error)
                    self._changed.notify_all()
                return
            if not chunk:
                continue
            lines = self._splitter.feed(chunk, self._clock())
            if lines:
                with self._changed:
                    self._lines.extend(lines)
                    self._changed.notify_all()

    def since(self, number: int) -> list[Line[Value]]:
        """The lines after line `number`, as far as they are kept."""
        with self._changed:
            newer = []
            for line in reversed(self._lines):
                if line.number <= number:
                    break
                newer.append(line)
        return newer[::-1]

    def wait(self, number: int, seconds: float) -> None:
        """Until there is a line after line `number` or the port is lost, for `seconds` at most."""
        with self._changed:
            self._changed.wait_for(lambda: self._after(number) or self.lost is not None, seconds)

    def _after(self, number: int) -> bool:
        return bool(self._lines) and self._lines[-1].number > number

    def close(self) -> None:
        """Stop reading and let go of the port."""
        self._closing = True
        self._thread.join(timeout=1.0)
        with contextlib.suppress(OSError):
            self._serial.close()
