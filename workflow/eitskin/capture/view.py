"""The progress of a capture, for a person at the bench."""

import contextlib
import sys
import time
from typing import TextIO


class View:
    """One line that is written over at a terminal; elsewhere one line a contact."""

    def __init__(self, stream: TextIO = sys.stderr):
        self._stream = stream
        self._terminal = stream.isatty()
        self._status: dict = {}
        self._width = 0

    def __call__(self, news: dict) -> None:
        """Update the status by `news` and show it."""
        if "contact" in news:
            self._status = {
                "frames": 0,
                "refused": 0,
                "saturated": 0,
                "force_N": None,
                "depth_mm": None,
            }
        self._status |= {key: value for key, value in news.items() if key != "frame"}
        if "frame" in news:
            frame = news["frame"]
            self._status["frames"] += 1
            self._status["refused"] += frame["rejected_before"]
            self._status["saturated"] = frame["saturated"]
            self._status["force_N"] = frame["force_N"] - frame["zero_N"]
        if self._terminal:
            line = text(self._status)
            self._stream.write("\r" + line.ljust(self._width))
            self._width = len(line)
        elif news.get("phase") == "up":
            self._stream.write(text(self._status) + "\n")
        self._stream.flush()

    def close(self) -> None:
        """End the line that is being written over; a closed terminal is no error."""
        if self._terminal and self._width:
            with contextlib.suppress(OSError):
                self._stream.write("\n")
                self._stream.flush()


def text(status: dict) -> str:
    """The status in words: contact, depth, force, frames and their faults, and the time left."""
    contact = status.get("contact")
    if contact is None:
        return "starting"
    parts = [
        f"contact {status['number']} of {status['of']}",
        f"{contact.probe_mm:g} mm at ({contact.x_mm:.1f}, {contact.y_mm:.1f}) mm",
        status.get("phase", "travelling"),
    ]
    if status["depth_mm"] is not None:
        parts.append(f"depth {status['depth_mm']:.1f} mm")
    if status["force_N"] is not None:
        parts.append(f"{status['force_N']:.2f} of {contact.target_N:.1f} N")
    frames = f"{status['frames']} frames"
    if status["refused"]:
        frames += f", {status['refused']} lines refused"
    if status["saturated"]:
        frames += f", {status['saturated']} channels saturated"
    parts.append(frames)
    if status["left_s"] is not None:
        parts.append(f"{time.strftime('%H:%M:%S', time.gmtime(status['left_s']))} left")
    return " · ".join(parts)
