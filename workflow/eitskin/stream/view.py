"""The output of a stream, for a person or a program."""

import fcntl
import json
import os
import select
import stat
import struct
import sys
import termios
import time
from typing import TextIO

from eitskin.data.dataset import TARGETS, UNITS
from eitskin.quantities import plain
from eitskin.stream.frames import Frame, Trouble
from eitskin.stream.judge import Verdict
from eitskin.stream.sources import Stop

LATE_S = 0.1  # from a frame to its line: more is said in words, as a person notices it
UNREAD_S = 5e-4  # from one look at an unread line to the next
DECIMALS = {"x": 1, "y": 1, "F": 2, "depth": 1}  # below the intervals of the best models


class View:
    """One line that is written over at a terminal; elsewhere a line a frame, JSON where asked.

    A pipe gets a line once its reader has taken the one before, so that what a line says of its
    lateness holds when it is read; a request to `stop` ends the wait.
    """

    def __init__(
        self,
        targets: list[str],
        as_json: bool = False,
        stream: TextIO | None = None,
        stop: Stop | None = None,
    ):
        self._targets, self._json = targets, as_json
        self._stream = sys.stdout if stream is None else stream
        self._terminal = self._stream.isatty() and not as_json
        self._width = 0
        self._pipe, self._stop = _pipe(self._stream), Stop() if stop is None else stop

    def frame(self, frame: Frame, verdict: Verdict) -> float:
        """Show a frame's verdict, how late that is, and above it its notices; the lateness in s."""
        self._wait_for_reader()
        late_s = time.perf_counter() - frame.ready_s
        if self._json:
            self._print(json.dumps(as_json(self._targets, frame, verdict, late_s)))
            return late_s
        for notice in verdict.notices:
            self.print_line(f"{frame.time_s:.2f} s: {notice}")
        self._line(text(self._targets, frame, verdict, late_s))
        return late_s

    def _wait_for_reader(self) -> None:
        """Wait until a pipe is empty, nobody reads it any more, or a stop is requested."""
        if self._pipe is None:
            return
        reader_gone = select.poll()
        reader_gone.register(self._pipe, 0)
        while _unread(self._pipe) and not (self._stop.is_requested or reader_gone.poll(0)):
            time.sleep(UNREAD_S)

    def trouble(self, trouble: Trouble) -> None:
        """Show what came in place of a frame."""
        if self._json:
            self._print(
                json.dumps({"time_s": round(trouble.time_s, 4), "trouble": trouble.message})
            )
        else:
            self.print_line(f"{trouble.time_s:.2f} s: {trouble.message}")

    def print_line(self, text: str) -> None:
        """Print a line that is not written over."""
        if self._terminal and self._width:
            self._stream.write("\r" + " " * self._width + "\r")
            self._width = 0
        self._print(text)

    def close(self) -> None:
        """End the line that is being written over."""
        if self._terminal and self._width:
            self._print("")

    def _line(self, line: str) -> None:
        line = plain(line)
        if not self._terminal:
            self._print(line)
            return
        self._stream.write("\r" + line.ljust(self._width))
        self._stream.flush()
        self._width = len(line)

    def _print(self, text: str) -> None:
        self._stream.write(plain(text) + "\n")
        self._stream.flush()


def _pipe(stream: TextIO) -> int | None:
    """The descriptor of a stream into a pipe; None for another stream."""
    try:
        descriptor = stream.fileno()
    except OSError:  # a stream in memory
        return None
    return descriptor if stat.S_ISFIFO(os.fstat(descriptor).st_mode) else None


def _unread(pipe: int) -> int:
    """The bytes in a pipe."""
    return struct.unpack("i", fcntl.ioctl(pipe, termios.FIONREAD, struct.pack("i", 0)))[0]


def text(targets: list[str], frame: Frame, verdict: Verdict, late_s: float) -> str:
    """A frame in words: time, verdict, each target with its interval, missing readings, and how
    late that is where it is LATE_S or more."""
    parts = [f"{frame.time_s:9.2f} s", verdict.kind]
    if verdict.reason:
        parts.append(verdict.reason)
    elif verdict.estimate is not None:
        values = zip(targets, verdict.estimate.state, verdict.estimate.half, strict=True)
        for target, value, half_width in values:
            digits = DECIMALS[target]
            parts.append(f"{target} {value:.{digits}f} ± {half_width:.{digits}f} {UNITS[target]}")
    if verdict.lost_electrodes:
        parts.append(f"without electrode {' and '.join(map(str, verdict.lost_electrodes))}")
    if verdict.n_missing and not verdict.reason:
        parts.append(f"{verdict.n_missing} readings left out")
    if late_s >= LATE_S:
        parts.append(f"{late_s:.1f} s late")
    return " · ".join(parts)


def as_json(targets: list[str], frame: Frame, verdict: Verdict, late_s: float) -> dict:
    """A frame as one JSON object; `low` and `high` are the interval's ends, `late_s` is the time
    from the frame's end to this line."""
    fields: dict = {
        "time_s": round(frame.time_s, 4),
        "late_s": round(late_s, 4),
        "verdict": verdict.kind,
    }
    if verdict.estimate is not None and not verdict.reason:
        values = zip(targets, verdict.estimate.state, verdict.estimate.half, strict=True)
        for target, value, half_width in values:
            fields[TARGETS[target]] = {
                "value": round(float(value), 4),
                "low": round(float(value - half_width), 4),
                "high": round(float(value + half_width), 4),
            }
    fields |= {"lost": list(verdict.lost_electrodes), "left_out": verdict.n_missing}
    if verdict.reason:
        fields["why"] = verdict.reason
    if verdict.notices:
        fields["news"] = list(verdict.notices)
    return fields
