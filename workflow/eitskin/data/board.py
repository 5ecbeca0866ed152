"""An EIT board that prints a frame a line: one YAML file says how its line is read.

Capture, stream, importer and emulator ask a board for its channels, readings, kind of voltage,
linear range and timing; none knows one by itself. A line that is not exactly what the firmware
prints is refused as a whole; nothing is repaired. The one fault that a line cannot show is a
possible number in place of another.
"""

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from eitskin import yaml_file
from eitskin.data.channel_order import in_order
from eitskin.errors import InputError
from eitskin.physics.protocol import PATTERNS, channel_table, every_channel, undriven
from eitskin.schema import Validator, dotted, explained, one_of

SCHEMA = Path(__file__).parent / "board.schema.yaml"
FOLDER = Path(__file__).parent / "boards"
SUFFIX = ".yaml"
NAMES = tuple(sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}")))
TIMING = ("baud", "period_s", "frame_s")  # which a rig may state anew
DEFAULTS = {"driven": "absent", "factor": 1.0, "unit": "V", "start": ""}
ABSENT, ZERO = "absent", "zero"  # what is printed of pairs that touch a driven electrode
RMS, SIGNED = "rms", "signed"  # kinds of voltage
# Of printf, in what stands before and behind the numbers.
CONVERSION = re.compile(r"%[-+ 0]?\d*(?:\.\d+)?(?P<kind>[duxXfeg])")
WHOLE, REAL = r" *[-+]?\d+", r" *[-+]?\d[\d.e+-]*"
CONVERTED = {"d": WHOLE, "u": WHOLE, "x": " *[0-9A-Fa-f]+", "f": REAL, "e": REAL, "g": REAL}
TIE = 1e-9  # of a number: less than any printed digit, more than a float's rounding


@dataclass(frozen=True)
class Reject:
    """A line that is no reading: `reason` is one of a few words to count by, `detail` its text."""

    reason: str
    detail: str


@dataclass(frozen=True)
class Board:
    """A board as described.

    `description` has the keys of board.schema.yaml, `printed` (P, 4) the channels of all printed
    numbers, `is_recorded` (P,) bool those that are readings.
    """

    name: str
    description: dict
    printed: np.ndarray
    is_recorded: np.ndarray

    @property
    def n_electrodes(self) -> int:
        """The number of electrodes."""
        return self.description["electrodes"]

    @property
    def channels(self) -> np.ndarray:
        """(M, 4): the channels of the readings."""
        return self.printed[self.is_recorded]

    @property
    def voltage(self) -> str:
        """The kind of voltage in the recording format's terms: signed or magnitude."""
        return SIGNED if self.description["voltage"] == SIGNED else "magnitude"

    @property
    def unit(self) -> str:
        """The readings' unit in the recording format's terms."""
        return self._setting("unit")

    @property
    def is_rms(self) -> bool:
        """Whether readings are RMS, not amplitudes."""
        return self.description["voltage"] == RMS

    @property
    def unit_text(self) -> str:
        """The unit for a person: V RMS where readings are so."""
        return f"{self.unit} RMS" if self.is_rms else self.unit

    @property
    def ceiling(self) -> float:
        """The size of a reading above which the converter is not linear."""
        return self._setting("factor") * self.description["ceiling"]

    @property
    def baud(self) -> int:
        """The line's rate."""
        return self.description["baud"]

    @property
    def period_s(self) -> float:
        """From one frame's line to the next."""
        return self.description["period_s"]

    @property
    def frame_s(self) -> float:
        """How long one frame is measured."""
        return self.description["frame_s"]

    @property
    def start(self) -> bytes:
        """What the host sends when it opens the port."""
        return self._setting("start").encode()

    def saturated(self, readings: np.ndarray) -> np.ndarray:
        """Bool, of the shape of `readings`: whether each lies above the linear range."""
        return np.abs(readings) > self.ceiling

    def parse(self, line: bytes) -> np.ndarray | Reject | None:
        """The readings (M,) in the unit, or why the line is no frame; None for a remark."""
        if not line.endswith(b"\n"):
            return Reject("half line", f"{len(line)} bytes without an end")
        remarks = self.description.get("remarks")
        if remarks is not None and re.fullmatch(remarks.encode(), line.rstrip(b"\r\n")):
            return None
        grammar = self.description["line"]
        match = _frame_form(grammar.get("begin", ""), grammar["end"]).fullmatch(line)
        if match is None:
            return Reject("form", f"it begins {line[:16]!r} and ends {line[-16:]!r}")
        fields = match["numbers"].split(grammar["between"].encode())
        if len(fields) != len(self.printed):
            return Reject("count", f"{len(fields)} values, expected {len(self.printed)}")
        printing = (grammar["number"], self.description.get("step"), *self.description["range"])
        numbers = np.array([_number(field, *printing) for field in fields])
        if np.isnan(numbers).any():
            place = int(np.flatnonzero(np.isnan(numbers))[0])
            low, high = self.description["range"]
            expected = f"{grammar['number']} from {low:g} to {high:g}"
            expected += f" in steps of {step:g}" if (step := self.description.get("step")) else ""
            detail = f"value {place} is {fields[place][:20]!r}, expected {expected}"
            return Reject("value", detail)
        driven = numbers[~self.is_recorded]
        if self._setting("driven") == ZERO and driven.any():
            largest = driven[np.abs(driven).argmax()]
            return Reject("driven pair", f"{largest} at a pair that touches a driven electrode")
        return self._setting("factor") * numbers[self.is_recorded]

    def _setting(self, key: str) -> Any:
        return self.description.get(key, DEFAULTS[key])


@lru_cache
def _frame_form(begin: str, end: str) -> re.Pattern[bytes]:
    """The form of a line with its `numbers`."""
    form = f"{_pattern(begin)}(?P<numbers>.*){_pattern(end)}"
    return re.compile(form.encode(), re.DOTALL)


def _pattern(text: str) -> str:
    """The regular expression of what printf makes of a text with any numbers."""
    pattern, position = "", 0
    for match in CONVERSION.finditer(text):
        pattern += re.escape(text[position : match.start()]) + CONVERTED[match["kind"].lower()]
        position = match.end()
    return pattern + re.escape(text[position:])


@lru_cache(maxsize=1 << 16)  # a converter of 10 bits prints a thousand texts
def _number(field: bytes, form: str, step: float | None, low: float, high: float) -> float:
    """The number in a field; NaN where no number within `low` and `high`, of whole steps where
    `step` is given, is printed so."""
    try:
        number = float(field)
    except ValueError:
        return math.nan
    if not low <= number <= high:
        return math.nan
    if step is None:
        return number if form.encode() % number == field else math.nan
    whole = step * round(number / step)
    printed = {form.encode() % (whole * (1.0 + tie)) for tie in (-TIE, TIE)}  # rounded either way
    return number if field in printed else math.nan


def read(profile: str | Path, file: str | Path = "board", place: str = "board") -> Board:
    """The board of a name in NAMES or of a YAML file's path.

    Raises InputError naming `file` and `place` for an unknown name, and the YAML file for one that
    is missing or describes no board.
    """
    path = Path(profile)
    if str(profile) in NAMES:
        path = FOLDER / f"{profile}{SUFFIX}"
    elif path.suffix != SUFFIX:
        names = one_of(NAMES, profile)
        raise InputError(file, place, repr(str(profile)), f"{names}, or a board's {SUFFIX} file")
    return described(str(profile), yaml_file.read(path), path)


def identity(profile: str) -> str | dict:
    """What distinguishes a board: its name in NAMES, else its description without TIMING."""
    if profile in NAMES:
        return profile
    return {key: value for key, value in read(profile).description.items() if key not in TIMING}


def described(name: str, description: dict, file: str | Path) -> Board:
    """The board of a description; raises InputError naming `file` for an invalid one."""
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    errors = sorted(
        Validator(schema).iter_errors(description), key=lambda error: len(error.absolute_path)
    )
    if errors:
        place, violation, expected = explained(errors[0])
        raise InputError(file, dotted(place), violation, expected)
    _check(description, file)
    printed = _printed(description, file)
    is_absent = description.get("driven", ABSENT) == ABSENT
    is_recorded = np.ones(len(printed), dtype=bool) if is_absent else undriven(printed)
    return Board(name, description, printed, is_recorded)


def _check(description: dict, file: str | Path) -> None:
    """Raise InputError for values that contradict each other."""
    low, high = description["range"]
    least = 0.0 if description["voltage"] != SIGNED else -math.inf
    if not least <= low < high:
        expected = "the smaller number first" if low >= high else "0 or more: no sign is printed"
        raise InputError(file, "range", [low, high], expected)
    if description["ceiling"] > max(abs(low), abs(high)):
        expected = f"at most {max(abs(low), abs(high)):g}, the range's"
        raise InputError(file, "ceiling", description["ceiling"], expected)
    if description["frame_s"] > description["period_s"]:
        expected = f"at most period_s, {description['period_s']}"
        raise InputError(file, "frame_s", description["frame_s"], expected)
    remarks = description.get("remarks", "")
    try:
        re.compile(remarks)
    except re.error as error:
        raise InputError(file, "remarks", repr(remarks), f"a regular expression: {error}") from None


def _printed(description: dict, file: str | Path) -> np.ndarray:
    """(P, 4): the channel of every printed number; raises InputError for an unknown pattern."""
    n, measurement = description["electrodes"], description["measurement"]
    is_absent = description.get("driven", ABSENT) == ABSENT
    if isinstance(measurement, list):
        for key in ("drive", "order"):
            if key in description:
                violation = f"{description[key]!r} beside a list of channels"
                raise InputError(file, key, violation, "none: the list says it")
    elif "drive" not in description:
        raise InputError(file, "drive", "no such key", PATTERNS)
    try:
        if isinstance(measurement, list):
            return channel_table(n, channels=measurement)
        channels = channel_table(n, description["drive"], measurement)
        if not is_absent:
            channels = every_channel(n, description["drive"], measurement)
    except InputError as error:
        raise InputError(file, error.place, error.actual, error.expected) from None
    order = description.get("order")
    return channels if order is None else in_order(file, order, channels, n)
