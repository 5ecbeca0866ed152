"""Complete lines from a serial port, each with its end time and that of the line before."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import serial

from eitskin.data.board import Reject

Value = TypeVar("Value")

LONGEST_LINE = 65536  # bytes: 30 times a frame of 16 electrodes; more without an end is noise
MAX_LINES = 4096  # 50 s of a load cell at 80 Hz, which is read every few ms
READ_S = 0.02  # below the period of every device


@dataclass(frozen=True)
class Line(Generic[Value]):
    """One line: its bytes, their value, and its end on the host's monotonic clock (s).

    `previous_end_s` is the end of the line before, `previous_ok` whether that was a reading.
    """

    number: int
    raw: bytes
    value: Value | Reject
    end_s: float
    previous_end_s: float
    previous_ok: bool

    @property
    def ok(self) -> bool:
        """Whether it is a reading."""
        return not isinstance(self.value, Reject)


class Splitter(Generic[Value]):
    """Splits bytes into lines as they arrive.

    What comes before the first newline is dropped: it began before the port was opened, and may be
    stale bytes joined to a frame. So is a line that `parse` takes for None, a remark.
    """

    def __init__(self, parse: Callable[[bytes], Value | Reject | None]):
        self._parse = parse
        self._pending = b""
        self._number = 0
        self._before: tuple[float, bool] | None = None  # end of the last line, whether a reading

    def feed(self, chunk: bytes, now_s: float) -> list[Line[Value]]:
        """The lines that `chunk`, read at `now_s`, completes."""
        *complete_lines, self._pending = (self._pending + chunk).split(b"\n")
        lines = []
        for line_bytes in complete_lines:
            if self._before is None:
                self._before = (now_s, False)
                continue
            value = self._parse(line_bytes + b"\n")
            if value is not None:
                lines.append(self._line(line_bytes + b"\n", value, now_s, self._before))
        if len(self._pending) > LONGEST_LINE:
            if self._before is not None:
                value = Reject("endless", f"{len(self._pending)} bytes without a newline")
                lines.append(self._line(self._pending, value, now_s, self._before))
            self._pending, self._before = b"", None
        return lines

    def _line(
        self, raw: bytes, value: Value | Reject, now_s: float, previous_end: tuple[float, bool]
    ) -> Line[Value]:
        self._number += 1
        line = Line(self._number, raw, value, now_s, *previous_end)
        self._before = (now_s, line.ok)
        return line


def plausible_period_s(period_s: float) -> tuple[float, float]:
    """The shortest and the longest plausible time (s) between two lines of a board.

    Half a period allows for jitter of the host's clock; less than two periods, or a lost line
    between them would pass unnoticed.
    """
    return 0.5 * period_s, 1.75 * period_s + 0.05


def is_frame_after(line: Line, moment_s: float, period_s: float) -> bool:
    """Whether a line is a frame that certainly began after `moment_s`.

    A board prints a frame once it is complete and then begins the next, so a frame began no earlier
    than the line before it ended. That line must be a frame too, or its end may be a stray newline.
    Two lines much closer than the board's period waited in a buffer, so that their times are the
    host's; two much farther apart may be the halves of two frames.
    """
    if not line.ok or not line.previous_ok or line.previous_end_s < moment_s:
        return False
    shortest_s, longest_s = plausible_period_s(period_s)
    return shortest_s <= line.end_s - line.previous_end_s <= longest_s


class Port(Generic[Value]):
    """A serial port read by its own thread until it is closed.

    Raises OSError (a SerialException is one) where the port cannot be opened. Where it is lost
    later the thread ends and `failure` holds the reason.
    """

    def __init__(
        self,
        device: str,
        baud: int,
        parse: Callable[[bytes], Value | Reject | None],
        start: bytes = b"",
        clock: Callable[[], float] = time.monotonic,
    ):
        self.device = device
        self.failure: str | None = None
        self._clock = clock
        self._splitter = Splitter(parse)
        self._lines: deque[Line[Value]] = deque(maxlen=MAX_LINES)
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
                    self.failure = str(error)
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
        """The lines after line `number`, of the last MAX_LINES."""
        with self._changed:
            newer = []
            for line in reversed(self._lines):
                if line.number <= number:
                    break
                newer.append(line)
        return newer[::-1]

    def wait(self, number: int, seconds: float) -> None:
        """Wait for a line after line `number` or a failure, for `seconds` at most."""
        with self._changed:
            self._changed.wait_for(lambda: self._after(number) or self.failure is not None, seconds)

    def _after(self, number: int) -> bool:
        return bool(self._lines) and self._lines[-1].number > number

    def close(self) -> None:
        """Stop reading and close the port."""
        self._closing = True
        self._thread.join(timeout=1.0)
        with contextlib.suppress(OSError):
            self._serial.close()
