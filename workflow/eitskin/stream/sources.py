"""Where frames come from: a board at its serial port, or a recording."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eitskin.capture.wire import BOARDS, Board, Reject, measured
from eitskin.data import importers
from eitskin.data.dataset import fits
from eitskin.data.recording import Recording, voltages
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.stream.frames import Event, Frame, Trouble
from eitskin.stream.kept import as_recording, is_kept
from eitskin.stream.untouched import OPENING

if TYPE_CHECKING:
    from eitskin.capture.lines import Port

WRONG_LINES = 5  # of the first lines; then the board is not what the model knows
SILENT_S = 3.0  # without a line
LEAST_S = 1e-4  # between two frames
LOOK_S = 0.1  # for a wish to end
GONE_S = 10.0  # without the port, until the stream gives up


@dataclass
class Stop:
    """Whether a stream is to end: `asked` is set by a signal, and seen between two frames."""

    asked: bool = False

    def sleep(self, seconds: float) -> None:
        """Wait, until it is asked."""
        end = time.perf_counter() + seconds
        while not self.asked and (left := end - time.perf_counter()) > 0.0:
            time.sleep(min(left, LOOK_S))


class Gone(Exception):
    """The board's port has vanished for good."""


def is_port(path: str | Path) -> bool:
    """Whether a path is a device's, not a file's."""
    return Path(path).is_char_device()


@dataclass
class Source:
    """Frames of a predictor's channels; `opening`: how many of the first nobody touches;
    difference: they are changes; about: what a recording of them says of its source."""

    events: Iterator[Event]
    opening: int
    difference: bool
    about: str


def board(device: str, baud: int, trained_on: dict, stop: Stop) -> Source:
    """A board whose channels and kind of voltage are those of a predictor's data.

    Raises InputError where no known board has them, and for a port that cannot be opened.
    """
    name = next((name for name, one in BOARDS.items() if _reads(one, trained_on)), None)
    if name is None:
        found = f"{len(trained_on['channels'])} channels of {trained_on['name']}"
        raise InputError("recording", "channels", found, f"those of a board: {', '.join(BOARDS)}")
    if trained_on.get("voltage") != "magnitude" or trained_on["unit"] != "V":
        found = f"{trained_on.get('voltage')} {trained_on['unit']} of {trained_on['name']}"
        raise InputError("recording", "voltage", found, f"magnitudes in V, as {name} reads")
    lost = np.array(trained_on.get("lost_channels", []), dtype=int)
    events = _lines(device, baud, BOARDS[name], lost, stop)
    return Source(events, OPENING, False, f"{name} at {device}")


def _reads(known: Board, trained_on: dict) -> bool:
    """Whether a board's channels are those trained on."""
    table = np.delete(
        channel_table(known.n_electrodes), trained_on.get("lost_channels", []), axis=0
    )
    return table.tolist() == trained_on["channels"]


def _lines(device: str, baud: int, known: Board, lost: np.ndarray, stop: Stop) -> Iterator[Event]:
    """A board's frames, and what is wrong with its lines. Raises Gone, and InputError for lines
    that are not this board's from the first on."""
    from eitskin.capture.lines import Port  # pyserial, which recordings do without

    chosen = measured(known.n_electrodes)
    try:
        port = Port(device, baud, known.parse, known.start, time.perf_counter)
    except OSError as error:
        raise InputError(device, "port", error, "a board that nobody else has open") from None
    start = last = time.perf_counter()
    number = refused = frames = 0
    latest = -LEAST_S
    try:
        while not stop.asked:
            port.wait(number, LOOK_S)
            now = time.perf_counter()
            for line in port.since(number):
                if stop.asked:
                    return
                number, last = line.number, line.end_s
                if isinstance(line.value, Reject):
                    refused += 1
                    said = f"{line.value.reason}: {line.value.detail}"
                    if not frames and refused == WRONG_LINES:
                        expected = f"a frame of {known.n_electrodes} electrodes"
                        raise InputError(device, f"{refused} lines", said, expected)
                    yield Trouble(line.end_s - start, f"a line refused, {said}")
                    continue
                frames += 1
                # lines that waited in a buffer have the host's time, one for all of them
                latest = max(line.end_s - start, latest + LEAST_S)
                reading = np.delete(line.value[chosen], lost)
                yield Frame(latest, line.end_s, reading, reading > known.linear_V)
            if port.lost is not None:
                yield Trouble(now - start, f"{device} is gone")
                port.close()
                again = _again(device, baud, known, stop)
                if again is None:
                    return
                port = again
                number, last = 0, time.perf_counter()
            elif now - last > SILENT_S:
                yield Trouble(now - start, f"no line for {now - last:.0f} s")
                last = now
    finally:
        port.close()


def _again(device: str, baud: int, known: Board, stop: Stop) -> "Port | None":
    """The port once it is back, None where the stream is to end. Raises Gone after GONE_S."""
    from eitskin.capture.lines import Port

    give_up = time.perf_counter() + GONE_S
    while time.perf_counter() < give_up and not stop.asked:
        time.sleep(0.1)
        try:
            return Port(device, baud, known.parse, known.start, time.perf_counter)
        except OSError:
            continue
    if stop.asked:
        return None
    raise Gone(f"{device} is gone for {GONE_S:g} s")


def recorded(path: str, trained_on: dict, fast: bool, stop: Stop) -> Source:
    """A recording's frames at its own time stamps, or as fast as they are judged; also of the
    journal that a stream has left.

    Raises InputError where its channels, unit or kind of voltage are not those trained on, and
    where its first frame is touched.
    """
    found = as_recording(path, whole=True) if is_kept(path) else importers.load(path)
    lost = fits(found, trained_on, path)
    voltages(found, path)
    difference = found.metadata["values"] == "difference"
    touched = found.frames["touch"].to_numpy(bool)
    first = int(touched.argmax()) if touched.any() else len(touched)
    if not difference and not first:
        raise InputError(path, "column touch, row 0", "true", "an untouched frame first")
    events = _replayed(found, np.array(lost, dtype=int), fast, stop)
    return Source(events, min(first, OPENING), difference, found.metadata["source"])


def _replayed(found: Recording, lost: np.ndarray, fast: bool, stop: Stop) -> Iterator[Event]:
    times = found.frames["time_s"].to_numpy(float)
    times = times - times[0]
    fast = fast or found.metadata["clock"] == "index"
    start = time.perf_counter()
    for time_s, reading in zip(times.tolist(), found.readings, strict=True):
        wait = start + time_s - time.perf_counter()
        if not fast:
            stop.sleep(wait)
        if stop.asked:
            return
        yield Frame(time_s, time.perf_counter(), np.delete(reading, lost))
