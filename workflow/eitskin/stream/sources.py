"""Where frames come from: a board at its serial port, or a recording."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eitskin.data import board, importers
from eitskin.data.board import Board, Reject
from eitskin.data.dataset import check_compatibility
from eitskin.data.recording import Recording, voltages
from eitskin.errors import InputError
from eitskin.stream.baseline import OPENING_FRAMES
from eitskin.stream.frames import Event, Frame, Trouble
from eitskin.stream.recorder import as_recording, is_journal

if TYPE_CHECKING:
    from eitskin.capture.lines import Port

MAX_WRONG_LINES = 5  # before the first frame: one may be cut short, five are another board's
SILENCE_LIMIT_S = 3.0  # without a line: some ten periods of the slowest board
MIN_INTERVAL_S = 1e-4  # between two frames: a recording's time must increase
FROZEN_FRAMES = 5  # alike to the last digit: no board whose noise reaches its step prints them
POLL_S = 0.1  # from one look at the stop flag to the next: below what a person notices
RECONNECT_LIMIT_S = 10.0  # without the port: enough to plug it in again


@dataclass
class Stop:
    """A request to end the stream, set by a signal and read between two frames."""

    is_requested: bool = False

    def sleep(self, seconds: float) -> None:
        """Wait, at most until a stop is requested."""
        end = time.perf_counter() + seconds
        while not self.is_requested and (remaining_s := end - time.perf_counter()) > 0.0:
            time.sleep(min(remaining_s, POLL_S))


class PortLost(Exception):
    """The board's port has vanished for good."""


def is_device(path: str | Path) -> bool:
    """Whether a path is a device's, not a file's."""
    return Path(path).is_char_device()


@dataclass
class Source:
    """Frames of a predictor's channels.

    The first `n_opening_frames` are untouched; with `is_difference` readings are changes;
    `description` is what a recording of them states as its source.
    """

    events: Iterator[Event]
    n_opening_frames: int
    is_difference: bool
    description: str


def board_source(
    device: str, profile: str | None, baud: int | None, trained_on: dict, stop: Stop
) -> Source:
    """The board at `device`: that of `profile`, as of `board.read`, else the one of `board.NAMES`
    whose channels are those of the data set `trained_on`. `baud`: where it is not the board's.

    Raises InputError for a board with other channels or another kind of voltage than trained on,
    and for one that is not described.
    """
    candidates = [board.read(name) for name in (board.NAMES if profile is None else (profile,))]
    eit_board = next((item for item in candidates if _has_channels(item, trained_on)), None)
    if eit_board is None:
        channels = f"{len(trained_on['channels'])} channels of {trained_on['name']}"
        expected = f"those of a board: {', '.join(item.name for item in candidates)}"
        raise InputError("recording", "channels", channels, f"{expected}; --board names another")
    if (trained_on.get("voltage"), trained_on["unit"]) != (eit_board.voltage, eit_board.unit):
        voltage = f"{trained_on.get('voltage')} {trained_on['unit']} of {trained_on['name']}"
        expected = f"{eit_board.voltage} {eit_board.unit}, as {eit_board.name} reads"
        raise InputError("recording", "voltage", voltage, expected)
    lost_channels = np.array(trained_on.get("lost_channels", []), dtype=int)
    events = _board_events(device, baud or eit_board.baud, eit_board, lost_channels, stop)
    return Source(events, OPENING_FRAMES, False, f"{eit_board.name} at {device}")


def _has_channels(eit_board: Board, trained_on: dict) -> bool:
    """Whether a board's channels are those trained on."""
    channels = np.delete(eit_board.channels, trained_on.get("lost_channels", []), axis=0)
    return channels.tolist() == trained_on["channels"]


def _board_events(
    device: str, baud: int, eit_board: Board, lost_channels: np.ndarray, stop: Stop
) -> Iterator[Event]:
    """Frames and troubles of a board's lines.

    A frame is a trouble where the board has repeated it FROZEN_FRAMES times. Raises PortLost, and
    InputError where none of the first lines is a frame of this board.
    """
    from eitskin.capture.lines import Port  # pyserial, which recordings do without

    try:
        port = Port(device, baud, eit_board.parse, eit_board.start, time.perf_counter)
    except OSError as error:
        raise InputError(device, "port", error, "a board that nobody else has open") from None
    start_s = last_line_s = time.perf_counter()
    line_number = n_rejects = n_frames = n_alike = 0
    previous_raw = b""
    latest_s = -MIN_INTERVAL_S
    try:
        while not stop.is_requested:
            port.wait(line_number, POLL_S)
            now_s = time.perf_counter()
            for line in port.since(line_number):
                if stop.is_requested:
                    return
                if (n_lost := line.number - line_number - 1) > 0:
                    yield Trouble(line.end_s - start_s, f"{n_lost} lines were not read in time")
                line_number, last_line_s = line.number, line.end_s
                if isinstance(line.value, Reject):
                    n_rejects += 1
                    message = f"{line.value.reason}: {line.value.detail}"
                    if not n_frames and n_rejects == MAX_WRONG_LINES:
                        expected = f"a frame of {eit_board.name}"
                        raise InputError(device, f"{n_rejects} lines", message, expected)
                    yield Trouble(line.end_s - start_s, f"a line refused, {message}")
                    continue
                n_frames += 1
                n_alike = n_alike + 1 if line.raw == previous_raw else 1
                previous_raw = line.raw
                if n_alike >= FROZEN_FRAMES:
                    message = f"the board repeats itself: {n_alike} frames alike to the last digit"
                    yield Trouble(line.end_s - start_s, message)
                    continue
                # lines that waited in a buffer have the host's time, one for all of them
                latest_s = max(line.end_s - start_s, latest_s + MIN_INTERVAL_S)
                reading = np.delete(line.value, lost_channels)
                yield Frame(latest_s, line.end_s, reading, eit_board.saturated(reading))
            if port.failure is not None:
                yield Trouble(now_s - start_s, f"{device} is gone")
                port.close()
                reopened_port = _reopen(device, baud, eit_board, stop)
                if reopened_port is None:
                    return
                port = reopened_port
                line_number, last_line_s = 0, time.perf_counter()
            elif now_s - last_line_s > SILENCE_LIMIT_S:
                yield Trouble(now_s - start_s, f"no line for {now_s - last_line_s:.0f} s")
                last_line_s = now_s
    finally:
        port.close()


def _reopen(device: str, baud: int, eit_board: Board, stop: Stop) -> "Port | None":
    """The port once it is back; None where a stop is requested.

    Raises PortLost after RECONNECT_LIMIT_S.
    """
    from eitskin.capture.lines import Port

    deadline_s = time.perf_counter() + RECONNECT_LIMIT_S
    while time.perf_counter() < deadline_s and not stop.is_requested:
        time.sleep(0.1)
        try:
            return Port(device, baud, eit_board.parse, eit_board.start, time.perf_counter)
        except OSError:
            continue
    if stop.is_requested:
        return None
    raise PortLost(f"{device} is gone for {RECONNECT_LIMIT_S:g} s")


def recording_source(path: str, trained_on: dict, fast: bool, stop: Stop) -> Source:
    """A recording or a stream's journal, replayed at its time stamps, or with `fast` at once.

    Raises InputError where its channels, unit or kind of voltage are not those trained on, and
    where its first frame is touched.
    """
    recording = (
        as_recording(path, with_undecided=True) if is_journal(path) else importers.load(path)
    )
    lost_channels = check_compatibility(recording, trained_on, path)
    voltages(recording, path)
    is_difference = recording.metadata["values"] == "difference"
    touched_mask = recording.frames["touch"].to_numpy(bool)
    n_untouched = int(touched_mask.argmax()) if touched_mask.any() else len(touched_mask)
    if not is_difference and not n_untouched:
        raise InputError(path, "column touch, row 0", "true", "an untouched frame first")
    events = _recording_events(recording, np.array(lost_channels, dtype=int), fast, stop)
    return Source(
        events, min(n_untouched, OPENING_FRAMES), is_difference, recording.metadata["source"]
    )


def _recording_events(
    recording: Recording, lost_channels: np.ndarray, fast: bool, stop: Stop
) -> Iterator[Event]:
    times_s = recording.frames["time_s"].to_numpy(float)
    times_s = times_s - times_s[0]
    fast = fast or recording.metadata["clock"] == "index"
    start_s = time.perf_counter()
    for time_s, reading in zip(times_s.tolist(), recording.readings, strict=True):
        delay_s = start_s + time_s - time.perf_counter()
        if not fast:
            stop.sleep(delay_s)
        if stop.is_requested:
            return
        yield Frame(time_s, time.perf_counter(), np.delete(reading, lost_channels))
