"""What a person or a program sees of a stream."""

import json
import sys
from typing import TextIO

from eitskin.data.dataset import TARGETS, UNITS
from eitskin.quantities import plain
from eitskin.stream.frames import Frame, Trouble
from eitskin.stream.judge import Verdict

FEWEST = {"x": 1, "y": 1, "F": 2, "depth": 1}  # decimals


class View:
    """One line that is written over at a terminal; elsewhere a line a frame, JSON where asked."""

    def __init__(self, targets: list[str], as_json: bool = False, out: TextIO | None = None):
        self._targets, self._json = targets, as_json
        self._out = sys.stdout if out is None else out
        self._terminal = self._out.isatty() and not as_json
        self._width = 0

    def frame(self, frame: Frame, verdict: Verdict) -> None:
        """Show a frame's verdict, above it what is new."""
        if self._json:
            self._print(json.dumps(as_json(self._targets, frame, verdict)))
            return
        for news in verdict.news:
            self.say(f"{frame.time_s:.2f} s: {news}")
        self._line(text(self._targets, frame, verdict))

    def trouble(self, trouble: Trouble) -> None:
        """Show what came in place of a frame."""
        if self._json:
            self._print(json.dumps({"time_s": round(trouble.time_s, 4), "trouble": trouble.words}))
        else:
            self.say(f"{trouble.time_s:.2f} s: {trouble.words}")

    def say(self, words: str) -> None:
        """A line that stays."""
        if self._terminal and self._width:
            self._out.write("\r" + " " * self._width + "\r")
            self._width = 0
        self._print(words)

    def close(self) -> None:
        """End the line."""
        if self._terminal and self._width:
            self._print("")

    def _line(self, line: str) -> None:
        if not self._terminal:
            self._print(line)
            return
        self._out.write("\r" + line.ljust(self._width))
        self._out.flush()
        self._width = len(line)

    def _print(self, line: str) -> None:
        self._out.write(line + "\n")
        self._out.flush()


def text(targets: list[str], frame: Frame, verdict: Verdict) -> str:
    """A frame in words: time, verdict, each target with its interval, what the estimate does
    without."""
    parts = [f"{frame.time_s:9.2f} s", verdict.kind]
    if verdict.why:
        parts.append(verdict.why)
    elif verdict.estimate is not None:
        values = zip(targets, verdict.estimate.state, verdict.estimate.half, strict=True)
        for target, value, half in values:
            digits = FEWEST[target]
            parts.append(f"{target} {value:.{digits}f} ± {half:.{digits}f} {UNITS[target]}")
    if verdict.lost:
        parts.append(f"without electrode {' and '.join(map(str, verdict.lost))}")
    if verdict.left_out and not verdict.why:
        parts.append(f"{verdict.left_out} readings left out")
    return plain(" · ".join(parts))


def as_json(targets: list[str], frame: Frame, verdict: Verdict) -> dict:
    """A frame as one JSON object; `low` and `high` are the interval's ends."""
    said: dict = {"time_s": round(frame.time_s, 4), "verdict": verdict.kind}
    if verdict.estimate is not None and not verdict.why:
        values = zip(targets, verdict.estimate.state, verdict.estimate.half, strict=True)
        for target, value, half in values:
            said[TARGETS[target]] = {
                "value": round(float(value), 4),
                "low": round(float(value - half), 4),
                "high": round(float(value + half), 4),
            }
    said |= {"lost": list(verdict.lost), "left_out": verdict.left_out}
    if verdict.why:
        said["why"] = verdict.why
    if verdict.news:
        said["news"] = list(verdict.news)
    return said
