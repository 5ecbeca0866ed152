"""What a person at the bench sees while the rig captures."""

import contextlib
import sys
import time
from typing import TextIO


class View:
    """One line that is written over at a terminal; elsewhere one line a contact."""

    def __init__(self, out: TextIO = sys.stderr):
        self._out = out
        self._terminal = out.isatty()
        self._about: dict = {}
        self._width = 0

    def __call__(self, news: dict) -> None:
        """Take what is new and show it."""
        if "contact" in news:
            self._about = {
                "frames": 0,
                "refused": 0,
                "saturated": 0,
                "force_N": None,
                "depth_mm": None,
            }
        self._about |= {key: value for key, value in news.items() if key != "frame"}
        if "frame" in news:
            frame = news["frame"]
            self._about["frames"] += 1
            self._about["refused"] += frame["rejected_before"]
            self._about["saturated"] = frame["saturated"]
            self._about["force_N"] = frame["force_N"] - frame["zero_N"]
        if self._terminal:
            line = text(self._about)
            self._out.write("\r" + line.ljust(self._width))
            self._width = len(line)
        elif news.get("phase") == "up":
            self._out.write(text(self._about) + "\n")
        self._out.flush()

    def close(self) -> None:
        """End the line; a terminal that is gone is no error."""
        if self._terminal and self._width:
            with contextlib.suppress(OSError):
                self._out.write("\n")
                self._out.flush()


def text(about: dict) -> str:
    """Contact, depth, force, frames and what was wrong with them, and the time left."""
    contact = about.get("contact")
    if contact is None:
        return "starting"
    parts = [
        f"contact {about['number']} of {about['of']}",
        f"{contact.probe_mm:g} mm at ({contact.x_mm:.1f}, {contact.y_mm:.1f}) mm",
        about.get("phase", "travelling"),
    ]
    if about["depth_mm"] is not None:
        parts.append(f"depth {about['depth_mm']:.1f} mm")
    if about["force_N"] is not None:
        parts.append(f"{about['force_N']:.2f} of {contact.target_N:.1f} N")
    frames = f"{about['frames']} frames"
    if about["refused"]:
        frames += f", {about['refused']} lines refused"
    if about["saturated"]:
        frames += f", {about['saturated']} channels saturated"
    parts.append(frames)
    if about["left_s"] is not None:
        parts.append(f"{time.strftime('%H:%M:%S', time.gmtime(about['left_s']))} left")
    return " · ".join(parts)
