"""Parsers of the devices' serial lines: bytes to values, or why not. No clock, no port.

A line that is not exactly what the firmware prints is refused as a whole; nothing is repaired. The
one fault that a line cannot show is a possible value in place of another.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

N_PER_KG = 9.80665
LARGEST_N = 500.0  # no load cell of a tactile rig reads more
RMS_STEP_V = 2.2 / 1024  # the firmware's RMS is a whole number of steps of its 10-bit converter
RMS_STEPS = 512  # at most: half the converter's range
NEWTON = re.compile(rb"-?(?:0|[1-9]\d{0,2})\.\d{4}")
OPENSCALE = re.compile(
    rb"(?P<ms>\d{1,10}),(?P<reading>-?(?:0|[1-9]\d{0,2})\.(?P<decimals>\d{1,5})),"
    rb"(?P<unit>kg|lbs),(?:-?\d{1,10}(?:\.\d{1,2})?,){0,3}"
)
HX711_BANNER = b"Load cell ready. Readings in Newtons (N):\r\n"
OPENSCALE_BANNER = b"Serial Load Cell Converter"


@dataclass(frozen=True)
class Reject:
    """A line that is no reading: `reason` is one of a few words to count by, `detail` its text."""

    reason: str
    detail: str


@dataclass(frozen=True)
class Restart:
    """A device's banner: it has just started, and a load cell has taken a new zero."""

    banner: str


def _rms_values() -> dict[bytes, float]:
    """Volts of every text that the firmware can print for an RMS: `%.4f`, ties either way."""
    volts_of_text = {}
    for step in range(RMS_STEPS + 1):
        tenths_mV = 1e4 * RMS_STEP_V * step
        for rounded in {math.ceil(tenths_mV - 0.5 - 1e-6), math.floor(tenths_mV + 0.5 + 1e-6)}:
            text = b"%.4f" % (1e-4 * rounded)
            volts_of_text[text] = float(text)
    return volts_of_text


RMS_VALUES = _rms_values()


def rms_frame(line: bytes, n_electrodes: int) -> np.ndarray | Reject:
    """(n, n) V: RMS of electrode pair j, j + 1 (column) while k, k + 1 drive (row).

    The line is n² values, each followed by a comma and a space, then a newline; each is a step of
    the converter, printed `%.4f` (circulartest_0731.ino of knazari/eit_hybrid_state_estimation).
    Pairs that touch a driven electrode are not measured and must be 0.
    """
    if not line.endswith(b"\n"):
        return Reject("half line", f"{len(line)} bytes without an end")
    fields = line[:-1].split(b", ")
    if fields.pop() != b"":
        return Reject("form", "no ', ' before the line's end")
    if len(fields) != n_electrodes**2:
        return Reject("count", f"{len(fields)} values, expected {n_electrodes**2}")
    values = [RMS_VALUES.get(field, math.nan) for field in fields]
    frame = np.array(values).reshape(n_electrodes, n_electrodes)
    if np.isnan(frame).any():
        place = int(np.flatnonzero(np.isnan(frame))[0])
        return Reject("value", f"value {place} is {fields[place][:20]!r}, no step of the converter")
    driven = frame[~measured_mask(n_electrodes)]
    if driven.any():
        return Reject("driven pair", f"{driven.max()} V at a pair that touches a driven electrode")
    return frame


def measured_mask(n_electrodes: int) -> np.ndarray:
    """(n, n) bool: the readings of an adjacent-adjacent board at pairs without driven electrode."""
    pair_distance = (np.arange(n_electrodes) - np.arange(n_electrodes)[:, None]) % n_electrodes
    return (pair_distance > 1) & (pair_distance < n_electrodes - 1)


def hx711_newtons(line: bytes) -> float | Reject | Restart:
    """Force in N from a line of the paper's load cell sketch, force_sensor.ino: `%.4f` and CR LF.

    A banner during a run means that the sketch took a new zero, with whatever lay on the cell.
    """
    if line == HX711_BANNER:
        return Restart(line[:-2].decode())
    if not line.endswith(b"\r\n"):
        return Reject("half line", f"{len(line)} bytes that do not end in CR LF")
    if not NEWTON.fullmatch(line[:-2]):
        return Reject("form", f"{line[:30]!r}")
    return _newtons(float(line[:-2]))


def openscale_newtons(line: bytes) -> float | Reject | Restart:
    """Force in N from a line of a SparkFun OpenScale 1.2: `ms,reading,unit,`, more fields, CR LF.

    Pounds and fewer than four decimals (1 mN) are refused; the board's menu sets them.
    """
    if line.startswith(OPENSCALE_BANNER):
        return Restart(line.strip().decode(errors="replace"))
    if not line.endswith(b"\r\n"):
        return Reject("half line", f"{len(line)} bytes that do not end in CR LF")
    match = OPENSCALE.fullmatch(line[:-2])
    if not match:
        return Reject("form", f"{line[:40]!r}")
    if match["unit"] != b"kg":
        return Reject("unit", "pounds; set the OpenScale to kg")
    if len(match["decimals"]) < 4:
        detail = f"{len(match['decimals'])} decimals of kg; set the OpenScale to 4"
        return Reject("resolution", detail)
    return _newtons(float(match["reading"]) * N_PER_KG)


def _newtons(force_N: float) -> float | Reject:
    if abs(force_N) > LARGEST_N:
        return Reject("range", f"{force_N} N, expected at most {LARGEST_N}")
    return force_N


@dataclass(frozen=True)
class Board:
    """An EIT board that prints RMS frames: the bytes that start it, and its linear range."""

    n_electrodes: int
    start: bytes
    linear_V: float  # RMS above which the converter is not linear

    def parse(self, line: bytes) -> np.ndarray | Reject:
        """A frame (n, n) V, or why the line is none."""
        return rms_frame(line, self.n_electrodes)


# circular-16: the paper's board. It hears nothing; the `y` is what the authors' host sends and the
# older firmware of the family waits for. 2.1 V peak to peak, the converter's linear range, is
# 0.742 V RMS. circular-32: the same text of lorcan2440/EIT_Touch_Sensor, which starts by itself.
BOARDS = {
    "circular-16": Board(16, b"y", 0.742),
    "circular-32": Board(32, b"", 0.742),
}
LOAD_CELLS: dict[str, Callable[[bytes], float | Reject | Restart]] = {
    "hx711": hx711_newtons,
    "openscale": openscale_newtons,
}
