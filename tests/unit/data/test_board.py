"""Boards' lines: what a description says is read, anything else is refused, nothing crashes."""

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data import board
from eitskin.data.board import Reject
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table

N = 16
STEP_V = 2.2 / 1024
PAPER = board.read("circular-16")
CORRUPTED = 10_000


def measured_mask(n: int) -> np.ndarray:
    """(n, n) bool: pairs without a driven electrode, drives in rows."""
    distance = (np.arange(n) - np.arange(n)[:, None]) % n
    return (distance > 1) & (distance < n - 1)


def firmware_line(steps: np.ndarray) -> bytes:
    """What the board prints for RMS values (n, n) in steps of its converter."""
    return b"".join(b"%.4f, " % (step * 2.2 / 1024) for step in steps.ravel()) + b"\n"


def frame_steps(draw: np.random.Generator) -> np.ndarray:
    """(16, 16) whole steps; 0 where a pair touches a driven electrode."""
    return np.where(measured_mask(N), draw.integers(0, 513, (N, N)), 0)


LINE = firmware_line(frame_steps(np.random.default_rng(7)))


def test_a_frame_as_the_firmware_prints_it():
    steps = frame_steps(np.random.default_rng(1))
    frame = PAPER.parse(firmware_line(steps))
    expected = steps[measured_mask(N)] * STEP_V
    np.testing.assert_allclose(frame, expected, atol=0.5e-4 + 1e-12)
    assert frame.max() <= 1.1


def test_the_line_of_a_board_that_measures_a_ramp():
    steps = np.where(measured_mask(N), np.arange(N * N).reshape(N, N), 0)
    line = firmware_line(steps)
    assert line.startswith(b"0.0000, 0.0000, 0.0043, 0.0064, ")
    assert line.endswith(b", 0.5435, 0.0000, \n") or line.endswith(b", 0.0000, \n")
    assert PAPER.parse(line)[0] == 0.0043


def test_a_reading_of_zero_is_a_reading():
    steps = frame_steps(np.random.default_rng(2))
    steps[3, 8] = 0
    channel = PAPER.channels.tolist().index([3, 4, 8, 9])
    assert PAPER.parse(firmware_line(steps))[channel] == 0.0


def test_the_measured_pairs_are_the_channels_in_their_order():
    channels = channel_table(N)
    np.testing.assert_array_equal(PAPER.channels, channels)
    place = N * channels[:, 0] + channels[:, 2]
    np.testing.assert_array_equal(np.flatnonzero(PAPER.is_recorded), place)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"", "half line"),
        (b"\n", "form"),
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
    assert PAPER.parse(line).reason == reason


def test_the_other_board_of_the_family():
    draw = np.random.default_rng(3)
    steps = np.where(measured_mask(32), draw.integers(0, 513, (32, 32)), 0)
    assert board.read("circular-32").parse(firmware_line(steps)).shape == (32 * 29,)
    assert board.read("circular-32").parse(LINE).reason == "count"


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
        parsed = PAPER.parse(faulty_line)
        assert isinstance(parsed, Reject), faulty_line
        kinds.add(parsed.reason)
    assert kinds == {"half line", "form", "count", "value", "driven pair"}


@settings(max_examples=2000)
@given(st.binary(max_size=4000))
def test_any_bytes_are_refused_without_a_crash(line):
    assert isinstance(PAPER.parse(line), Reject)


@settings(max_examples=2000)
@given(st.integers(0, len(LINE) - 1), st.binary(max_size=16), st.integers(0, 16))
def test_bytes_in_place_of_others_are_a_frame_only_as_other_possible_values(start, new, length):
    faulty_line = LINE[:start] + new + LINE[start + length :]
    parsed = PAPER.parse(faulty_line)
    if not isinstance(parsed, Reject):
        assert len(faulty_line) == len(LINE)
        fields = zip(faulty_line.split(b", "), LINE.split(b", "), strict=True)
        for value, original in fields:
            steps = float(value.strip() or 0) / STEP_V
            assert value == original or abs(steps - round(steps)) * STEP_V <= 0.5001e-4


BENCH = {  # 208 signed millivolts, numbered lines, nothing of pairs at driven electrodes
    "electrodes": 16,
    "drive": "adjacent",
    "measurement": "adjacent",
    "line": {"begin": "EIT %d:", "number": "%.3f", "between": ";", "end": " *%02X\r\n"},
    "remarks": "#.*",
    "factor": 0.001,
    "voltage": "signed",
    "range": [-1650, 1650],
    "ceiling": 1500,
    "baud": 250000,
    "period_s": 0.2,
    "frame_s": 0.15,
}


def described(**changed) -> board.Board:
    """A board like BENCH; a key that is None is left out."""
    description = {key: v for key, v in (BENCH | changed).items() if v is not None}
    return board.described("bench", description, "bench.yaml")


def bench_line(millivolts, number="%.3f") -> bytes:
    return ("EIT 17:" + ";".join(number % v for v in millivolts) + " *0F\r\n").encode()


def test_a_board_of_another_grammar_kind_and_unit():
    millivolts = np.random.default_rng(1).uniform(-1600, 1600, 208).round(3)
    bench = described()
    reading = bench.parse(bench_line(millivolts))
    np.testing.assert_allclose(reading, 1e-3 * millivolts, rtol=1e-12)
    np.testing.assert_array_equal(bench.saturated(reading), np.abs(millivolts) > 1500)
    assert (bench.voltage, bench.unit_text, bench.ceiling) == ("signed", "V", 1.5)
    assert bench.parse(b"# gain 3\r\n") is None
    for line, reason in (
        (bench_line(millivolts[1:]), "count"),
        (bench_line(millivolts, "%.2f"), "value"),
        (bench_line(np.where(np.arange(208) == 3, 1700.0, 0.0)), "value"),
        (bench_line(millivolts)[1:], "form"),
        (bench_line(millivolts).replace(b"*", b"", 1), "form"),
        (bench_line(millivolts).replace(b";", b"\x00", 1), "count"),
        (bench_line([math.nan] * 208), "value"),
        (bench_line(millivolts)[:-1], "half line"),
    ):
        assert bench.parse(line).reason == reason, line[:40]


@pytest.mark.parametrize(
    ("changed", "numbers", "recorded"),
    [
        ({"electrodes": 8}, 40, 40),
        ({"electrodes": 13}, 130, 130),
        ({"drive": "opposite"}, 192, 192),
        ({"driven": "zero"}, 256, 208),
        ({"driven": "ignored", "electrodes": 8}, 64, 40),
        ({"measurement": [[0, 1, 2, 3], [1, 2, 3, 4]], "drive": None}, 2, 2),
        ({"order": "measurement-source-ascending"}, 208, 208),
    ],
)
def test_the_channels_that_a_description_says(changed, numbers, recorded):
    described_board = described(**changed)
    printed, channels = described_board.printed, described_board.channels
    assert (len(printed), len(channels)) == (numbers, recorded)
    line = bench_line(np.where(described_board.is_recorded, np.arange(numbers), 0.0))
    expected = 1e-3 * np.arange(numbers)[described_board.is_recorded]
    np.testing.assert_allclose(described_board.parse(line), expected)
    spoilt = described_board.parse(bench_line(np.arange(1.0, numbers + 1.0)))
    assert isinstance(spoilt, Reject) == (changed.get("driven") == "zero")
    if "order" in changed:
        assert channels[:2].tolist() == [[2, 3, 0, 1], [3, 4, 0, 1]]


@pytest.mark.parametrize(
    ("form", "value"),
    [("%d", -12), ("%8.4f", 0.25), ("%+.3e", -12.5), ("%g", 0.125), ("%.0f", 7), ("%06.2f", 1.5)],
)
def test_numbers_in_any_format_of_printf(form, value):
    bench = described(line=BENCH["line"] | {"number": form}, factor=None)
    line = bench_line([value] * 208, form)
    np.testing.assert_array_equal(bench.parse(line), [float(value)] * 208)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"electrodes": None}, "electrodes: found no such key, expected the number of electrodes"),
        ({"drive": None}, "drive: found no such key, expected adjacent, opposite or skip-<n>"),
        ({"drive": "near"}, "pattern: found 'near', expected adjacent, opposite or skip-<n>"),
        ({"measurement": [[0, 1, 2, 2]]}, "drive: found 'adjacent' beside a list of channels"),
        ({"measurement": [[0, 1, 2, 16]], "drive": None}, r"channels\[0\]: found .0, 1, 2, 16"),
        ({"order": "mine"}, "order: found 'mine', expected one of drive-plus"),
        ({"voltage": "rms"}, "range: found .*, expected 0 or more: no sign is printed"),
        ({"range": [1, 1]}, "range: found .*, expected the smaller number first"),
        ({"ceiling": 2000}, "ceiling: found 2000, expected at most 1650"),
        ({"frame_s": 0.3}, "frame_s: found 0.3, expected at most period_s, 0.2"),
        ({"remarks": "("}, "remarks: found .* expected a regular expression"),
        ({"line": BENCH["line"] | {"end": ";"}}, "line.end: found ';', expected what stands behin"),
        ({"line": BENCH["line"] | {"number": "%s"}}, "line.number: found '%s', expected printf's"),
        ({"colour": "red"}, "colour: found an unknown key"),
    ],
)
def test_a_description_that_is_none_is_one_message(changed, message):
    with pytest.raises(InputError, match=f"^bench.yaml: {message}") as refused:
        described(**changed)
    assert "\n" not in str(refused.value)


def test_a_board_that_there_is_not():
    with pytest.raises(InputError, match=r"rig.yaml: rig.board.profile: found 'circular', exp"):
        board.read("circular", "rig.yaml", "rig.board.profile")
    with pytest.raises(InputError, match=r"none.yaml: file: found"):
        board.read("none.yaml")
