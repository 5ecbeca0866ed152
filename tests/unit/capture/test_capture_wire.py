"""Serial lines: what the firmware prints is read, anything else is refused, nothing crashes."""

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.capture.wire import (
    BOARDS,
    RMS_STEP_V,
    Reject,
    Restart,
    hx711_newtons,
    measured_mask,
    openscale_newtons,
    rms_frame,
)
from eitskin.physics.protocol import channel_table

N = 16
CORRUPTED = 10_000


def firmware_line(steps: np.ndarray) -> bytes:
    """What the board prints for RMS values (n, n) in steps of its converter."""
    return b"".join(b"%.4f, " % (step * 2.2 / 1024) for step in steps.ravel()) + b"\n"


def frame_steps(draw: np.random.Generator) -> np.ndarray:
    """(16, 16) whole steps; 0 where a pair touches a driven electrode."""
    return np.where(measured_mask(N), draw.integers(0, 513, (N, N)), 0)


LINE = firmware_line(frame_steps(np.random.default_rng(7)))


def test_a_frame_as_the_firmware_prints_it():
    steps = frame_steps(np.random.default_rng(1))
    frame = rms_frame(firmware_line(steps), N)
    np.testing.assert_allclose(frame, steps * RMS_STEP_V, atol=0.5e-4 + 1e-12)
    assert frame.max() <= 1.1


def test_the_line_of_a_board_that_measures_a_ramp():
    steps = np.where(measured_mask(N), np.arange(N * N).reshape(N, N), 0)
    line = firmware_line(steps)
    assert line.startswith(b"0.0000, 0.0000, 0.0043, 0.0064, ")
    assert line.endswith(b", 0.5435, 0.0000, \n") or line.endswith(b", 0.0000, \n")
    assert rms_frame(line, N)[0, 2] == 0.0043


def test_a_reading_of_zero_is_a_reading():
    steps = frame_steps(np.random.default_rng(2))
    steps[3, 8] = 0
    assert rms_frame(firmware_line(steps), N)[3, 8] == 0.0


def test_the_measured_pairs_are_the_channels_in_their_order():
    place = np.flatnonzero(measured_mask(N))
    channels = channel_table(N)
    np.testing.assert_array_equal(place, N * channels[:, 0] + channels[:, 2])


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"", "half line"),
        (b"\n", "count"),
        (LINE[:-1], "half line"),
        (LINE[8:], "count"),
        (LINE[:-1] + LINE, "count"),
        (LINE[:-1] + b"\r\n", "form"),
        (LINE.replace(b"0.0000, ", b"", 1), "count"),
        (LINE.replace(b"0.", b"0,", 1), "value"),
        (b"\x00" + LINE, "value"),
        (LINE.replace(b"0.0000", b"0.0021", 1), "driven pair"),
        (LINE.replace(b"0.0000", b"0.0010", 1), "value"),
        (LINE.replace(b"0.0000", b"-0.000", 1), "value"),
        (LINE.replace(b"0.0000", b"1.2000", 1), "value"),
        (b"nan, " * 256 + b"\n", "value"),
        (b"Drive gain: 1000\r\n", "form"),
        (b"\xff" * 3000 + b"\n", "form"),
    ],
)
def test_lines_that_are_no_frame(line, reason):
    assert rms_frame(line, N).reason == reason


def test_the_other_board_of_the_family():
    draw = np.random.default_rng(3)
    steps = np.where(measured_mask(32), draw.integers(0, 513, (32, 32)), 0)
    assert BOARDS["circular-32"].parse(firmware_line(steps)).shape == (32, 32)
    assert BOARDS["circular-32"].parse(LINE).reason == "count"


def corrupted(line: bytes, draw: random.Random) -> bytes:
    """A line as a bad cable, a full buffer or a restart leave it; never the line itself."""
    faulty_line = bytearray(line)
    kind = draw.randrange(8)
    if kind == 0:
        faulty_line = faulty_line[: draw.randrange(len(line))] + draw.choice([b"", b"\n"])
    elif kind == 1:
        faulty_line = faulty_line[draw.randrange(1, len(line)) :]
    elif kind == 2:
        start = draw.randrange(len(line))
        del faulty_line[start : start + draw.randint(1, 600)]
    elif kind == 3:
        start = draw.randrange(len(line))
        faulty_line[start:start] = draw.randbytes(draw.randint(1, 40))
    elif kind == 4:
        for _ in range(draw.randint(8, 40)):
            faulty_line[draw.randrange(len(line))] ^= 1 << draw.randrange(8)
    elif kind == 5:
        faulty_line = faulty_line[: draw.randrange(len(line))] + bytearray(line)
    elif kind == 6:
        fields = line[:-1].split(b", ")[:-1]
        place = draw.randrange(len(fields))
        fields[place : place + 1] = draw.choice([[], [fields[place]] * 2])
        faulty_line = bytearray(b"".join(field + b", " for field in fields) + b"\n")
    else:
        rows, columns = np.nonzero(~measured_mask(N))
        driven = N * rows + columns
        place = 8 * int(draw.choice(list(driven)))
        faulty_line[place : place + 6] = b"%.4f" % (draw.randint(1, 512) * 2.2 / 1024)
    return bytes(faulty_line)


def test_none_of_ten_thousand_corrupted_lines_is_a_frame():
    draw = random.Random(20)
    numbers = np.random.default_rng(20)
    lines = [firmware_line(frame_steps(numbers)) for _ in range(20)]
    kinds = set()
    for _ in range(CORRUPTED):
        line = draw.choice(lines)
        faulty_line = corrupted(line, draw)
        if faulty_line == line:  # bytes taken out of a run of themselves
            continue
        parsed = rms_frame(faulty_line, N)
        assert isinstance(parsed, Reject), faulty_line
        kinds.add(parsed.reason)
    assert kinds == {"half line", "form", "count", "value", "driven pair"}


@settings(max_examples=2000)
@given(st.binary(max_size=4000))
def test_any_bytes_are_refused_without_a_crash(line):
    assert isinstance(rms_frame(line, N), Reject)
    hx711_newtons(line)
    openscale_newtons(line)


@settings(max_examples=2000)
@given(st.integers(0, len(LINE) - 1), st.binary(max_size=16), st.integers(0, 16))
def test_bytes_in_place_of_others_are_a_frame_only_as_other_possible_values(start, new, length):
    faulty_line = LINE[:start] + new + LINE[start + length :]
    parsed = rms_frame(faulty_line, N)
    if not isinstance(parsed, Reject):
        assert len(faulty_line) == len(LINE)
        fields = zip(faulty_line.split(b", "), LINE.split(b", "), strict=True)
        for value, original in fields:
            steps = float(value.strip() or 0) / RMS_STEP_V
            assert value == original or abs(steps - round(steps)) * RMS_STEP_V <= 0.5001e-4


@pytest.mark.parametrize(
    ("line", "newtons"),
    [
        (b"-0.0012\r\n", -0.0012),
        (b"0.0000\r\n", 0.0),
        (b"9.8100\r\n", 9.81),
        (b"98.1000\r\n", 98.1),
    ],
)
def test_the_load_cell_of_the_paper(line, newtons):
    assert hx711_newtons(line) == newtons


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"1.2345\n", "half line"),
        (b"1.2345", "half line"),
        (b".2345\r\n", "form"),
        (b"1.23451.2345\r\n", "form"),
        (b"1.234\r\n", "form"),
        (b"01.2345\r\n", "form"),
        (b"nan\r\n", "form"),
        (b"1e3\r\n", "form"),
        (b" 1.2345\r\n", "form"),
        (b"\xb1.2345\r\n", "form"),
        (b"999.0000\r\n", "range"),
    ],
)
def test_lines_that_are_no_force(line, reason):
    assert hx711_newtons(line).reason == reason


def test_a_load_cell_that_greets_has_restarted():
    assert isinstance(hx711_newtons(b"Load cell ready. Readings in Newtons (N):\r\n"), Restart)
    assert isinstance(openscale_newtons(b"Serial Load Cell Converter version 1.2\r\n"), Restart)


def test_an_openscale():
    assert openscale_newtons(b"51588,0.8301,kg,24.75,\r\n") == pytest.approx(0.8301 * 9.80665)
    assert openscale_newtons(b"51588,-0.0002,kg,\r\n") == pytest.approx(-0.0002 * 9.80665)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"51588,0.8300,lbs,24.75,\r\n", "unit"),
        (b"51588,0.83,kg,24.75,\r\n", "resolution"),
        (b"51588,0.8301,kg\r\n", "form"),
        (b"51588,0.8301,kg,\n", "half line"),
        (b"0.8301,kg,\r\n", "form"),
        (b"51588,99.0000,kg,\r\n", "range"),
    ],
)
def test_lines_that_are_no_openscale_force(line, reason):
    assert openscale_newtons(line).reason == reason
