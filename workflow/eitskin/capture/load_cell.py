"""Parsers of load cells' serial lines: bytes to forces, or why not. No clock, no port.

A line that is not exactly what the firmware prints is refused as a whole; nothing is repaired. The
one fault that a line cannot show is a possible value in place of another.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from eitskin.data.board import Reject

N_PER_KG = 9.80665
LARGEST_N = 500.0  # no load cell of a tactile rig reads more
NEWTON = re.compile(rb"-?(?:0|[1-9]\d{0,2})\.\d{4}")
OPENSCALE = re.compile(
    rb"(?P<ms>\d{1,10}),(?P<reading>-?(?:0|[1-9]\d{0,2})\.(?P<decimals>\d{1,5})),"
    rb"(?P<unit>kg|lbs),(?:-?\d{1,10}(?:\.\d{1,2})?,){0,3}"
)
HX711_BANNER = b"Load cell ready. Readings in Newtons (N):\r\n"
OPENSCALE_BANNER = b"Serial Load Cell Converter"


@dataclass(frozen=True)
class Restart:
    """A device's banner: it has just started, and a load cell has taken a new zero."""

    banner: str


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


LOAD_CELLS: dict[str, Callable[[bytes], float | Reject | Restart]] = {
    "hx711": hx711_newtons,
    "openscale": openscale_newtons,
}
