"""The board and the load cell through pyserial, and what a pseudo-terminal can and cannot."""

import itertools
import json
import re
import time

import numpy as np
import pytest

from rigsim_process import PATIENCE_S, configuration, in_background

serial = pytest.importorskip("serial", reason="pyserial, of the extra rig, is not installed")

from rigsim.config import read_fault  # noqa: E402
from rigsim.rig import Rig  # noqa: E402

STEP_V = 2.2 / 1024  # of the paper's board


def made(tmp_path, **changed) -> Rig:
    return Rig(configuration(tmp_path, **changed))


def open_port(rig: Rig, device: str, baud: int = 115200) -> "serial.Serial":
    port = {"board": rig.board, "load_cell": rig.cell}[device].port
    return serial.Serial(str(port.link), baud, timeout=PATIENCE_S, exclusive=True)


def events(rig: Rig, event: str) -> list[dict]:
    lines = rig.log.path.read_text(encoding="utf-8").splitlines()
    return [e for e in map(json.loads, lines) if e["event"] == event]


def line_of(port) -> np.ndarray:
    return np.array([float(v) for v in port.readline().decode().split(", ")[:-1]])


def read_until(port, predicate) -> list[bytes]:
    """Lines up to the first that is wanted."""
    lines = [port.readline()]
    while not predicate(lines[-1]):
        assert lines[-1], "nothing comes any more"
        lines.append(port.readline())
    return lines


def near(force: float):
    """Whether a line is that force."""
    return lambda line: abs(float(line) - force) < 0.05


def test_the_board_is_silent_until_it_is_opened_and_then_says_frames_alone(tmp_path):
    rig = made(tmp_path)
    with in_background(rig.board.run()), open_port(rig, "board") as port:
        line = port.readline()
        assert re.fullmatch(rb"(\d\.\d{4}, ){256}\n", line)
        second = port.readline()
        assert second == line  # no noise, nobody touches
    frames = events(rig, "frame")
    opening = events(rig, "board opened")[0]
    assert frames[0]["began"] >= opening["t"] - 1e-3
    for previous, after in itertools.pairwise(frames):
        assert after["began"] >= previous["ended"]
        assert after["began"] - previous["began"] >= rig.board.period_s - 1e-3
    assert all(frame["ended"] - frame["began"] >= rig.board.frame_s for frame in frames)


def test_the_board_sees_a_press_and_its_readings_are_whole_codes(tmp_path):
    rig = made(tmp_path, board={**configuration(tmp_path)["board"]}, robot={"pose": PRESSED})
    rig.world.follow(np.array(PRESSED), 0.0)
    with in_background(rig.board.run()), open_port(rig, "board") as port:
        port.readline()
        pressed = line_of(port)
    codes = pressed / STEP_V
    assert np.abs(codes - np.round(codes)).max() * STEP_V <= 5e-5 + 1e-12
    assert events(rig, "frame")[-1]["force_N"] == pytest.approx(0.55 * 3.0**1.5, rel=1e-4)


def test_the_load_cell_tares_says_its_banner_and_then_newtons(tmp_path):
    rig = made(tmp_path)
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        assert port.readline() == b"Load cell ready. Readings in Newtons (N):\r\n"
        lines = [port.readline() for _ in range(20)]
        rig.world.force_N = 5.0
        late = read_until(port, near(5.0))
    assert all(re.fullmatch(rb"-?\d+\.\d{4}\r\n", line) for line in lines + late)
    assert all(map(near(0.0), lines))
    assert len(set(lines)) > 3  # noise


def test_a_load_on_the_cell_when_it_is_opened_becomes_its_zero(tmp_path):
    rig = made(tmp_path)
    rig.world.force_N = 2.0
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        port.readline()
        assert near(0.0)(port.readline())
        rig.world.force_N = 0.0
        read_until(port, near(-2.0))


def test_the_mean_of_four_lags_behind_a_step(tmp_path):
    rig = made(tmp_path, load_cell={"noise_N": 0.0})
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        read_until(port, lambda line: line == b"0.0000\r\n")
        for _ in range(6):
            port.readline()
        rig.world.force_N = 4.0
        lines = read_until(port, lambda line: line == b"4.0000\r\n")
    assert [float(line) for line in lines[-4:]] == [1.0, 2.0, 3.0, 4.0]


def test_an_openscale_says_kilograms_with_a_trailing_comma_and_has_a_menu(tmp_path):
    rig = made(tmp_path, load_cell={"profile": "openscale", "noise_N": 0.0})
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        assert b"version 1.2" in port.readline() + port.readline()
        port.readline()
        rig.world.force_N = 9.80665
        read_until(port, lambda line: re.fullmatch(rb"\d+,1\.0000,kg,\d+\.\d\d,\r\n", line))
        port.write(b"x")
        read_until(port, lambda line: b"Tare" in line)
        port.write(b"1x")
        read_until(port, lambda line: b"Exiting" in line)
        assert re.fullmatch(rb"\d+,-?0\.0000,kg,\d+\.\d\d,\r\n", port.readline())


@pytest.mark.parametrize("device", ["board", "load_cell"])
def test_the_wrong_baud_is_a_violation(tmp_path, device):
    rig = made(tmp_path)
    part = {"board": rig.board, "load_cell": rig.cell}[device]
    with in_background(part.run()), open_port(rig, device, 9600) as port:
        read_until(port, lambda line: events(rig, "violation"))
    (violation,) = events(rig, "violation")
    assert violation["found"] == 9600 and violation["expected"] == 115200


@pytest.mark.parametrize("device", ["board", "load_cell"])
def test_a_pulled_cable_ends_reads_and_the_next_terminal_has_the_same_link(tmp_path, device):
    rig = made(tmp_path)
    part = {"board": rig.board, "load_cell": rig.cell}[device]
    with in_background(part.run()) as loop:
        port = open_port(rig, device)
        port.readline()

        def let(fault: dict) -> None:
            loop.call_soon_threadsafe(rig.faults.begin, fault, time.monotonic())

        let({"fault": f"{device}_unplugged"})
        with pytest.raises(serial.SerialException):
            while True:
                port.readline()
        assert not part.port.link.is_symlink()
        let({"fault": f"{device}_unplugged", "end": True})
        while not part.port.link.is_symlink():
            time.sleep(0.01)
        with open_port(rig, device) as second_port:
            assert second_port.readline().endswith(b"\n")
        port.close()


def test_a_terminal_takes_one_host_at_a_time_and_has_no_modem_lines(tmp_path):
    rig = made(tmp_path)
    with open_port(rig, "board") as port:
        with pytest.raises(serial.SerialException):
            open_port(rig, "board")
        with pytest.raises(OSError):
            port.dtr = False


def test_lines_that_nobody_reads_are_a_violation(tmp_path):
    rig = made(tmp_path)
    rig.board.host.patience_s = 0.05
    with in_background(rig.board.run()), open_port(rig, "board"):
        give_up = time.monotonic() + PATIENCE_S
        while not events(rig, "violation") and time.monotonic() < give_up:
            time.sleep(0.01)
    assert events(rig, "violation")[0]["rule"] == "bytes never read"


@pytest.mark.parametrize(
    ("fault", "spoiled"),
    [
        ("board_short", lambda line: line.count(b",") < 256),
        ("board_long", lambda line: line.count(b",") == 256 + 512),
        ("board_joined", lambda line: line.count(b",") == 512),
        ("board_garbled", lambda line: not line.isascii()),
        ("board_driven", lambda line: line.startswith(b"0.0215")),
        ("board_saturated", lambda line: b"1.1000" in line),
    ],
)
def test_spoiled_lines_are_as_many_as_asked_for(tmp_path, fault, spoiled):
    rig = made(tmp_path)
    with in_background(rig.board.run()), open_port(rig, "board") as port:
        intact = port.readline()
        rig.faults.begin(read_fault(json.dumps({"fault": fault, "count": 2})), time.monotonic())
        lines = [port.readline() for _ in range(8)]
    assert sum(map(spoiled, lines)) == 2
    assert [line for line in lines if not spoiled(line)] == [intact] * 6
    assert not spoiled(intact)
    assert sum(not frame["as_read"] for frame in events(rig, "frame")) == 2


def test_a_duplicated_line_comes_twice_for_one_frame(tmp_path):
    rig = made(tmp_path, world={"noise": 0.01})
    with in_background(rig.board.run()), open_port(rig, "board") as port:
        port.readline()
        rig.faults.begin({"fault": "board_duplicated"}, time.monotonic())
        lines = [port.readline() for _ in range(8)]
    assert len(set(lines)) == 7


def test_a_silent_board_comes_back_after_its_time(tmp_path):
    rig = made(tmp_path)
    with in_background(rig.board.run()), open_port(rig, "board") as port:
        port.readline()
        rig.faults.begin({"fault": "board_silent", "for_s": 1.0}, 0.0)
        while not any(not frame["as_read"] for frame in events(rig, "frame")):
            time.sleep(0.01)
        rig.faults.tick(1.0)
        assert len(line_of(port)) == 256
    assert events(rig, "fault over")[0]["fault"] == "board_silent"


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ({"fault": "load_cell_nan"}, lambda line: line == b"nan\r\n"),
        ({"fault": "load_cell_spike"}, lambda line: float(line) > 7.0),
        ({"fault": "load_cell_offset", "size": 3.0}, near(3.0)),
        ({"fault": "load_cell_drift", "size": 50.0}, lambda line: float(line) > 5.0),
    ],
)
def test_what_a_spoiled_load_cell_says(tmp_path, fault, expected):
    rig = made(tmp_path)
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        port.readline()
        rig.faults.begin(fault, time.monotonic())
        read_until(port, expected)


def test_a_frozen_load_cell_says_the_same_for_as_long_as_it_lasts(tmp_path):
    rig = made(tmp_path)
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        port.readline()
        rig.faults.begin({"fault": "load_cell_frozen", "for_s": 1.0}, 0.0)
        late = [port.readline() for _ in range(40)][-5:]
        assert len(set(late)) == 1
        rig.faults.tick(1.0)
        read_until(port, lambda line: line != late[-1])


def test_a_spike_is_over_after_the_mean(tmp_path):
    rig = made(tmp_path)
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        port.readline()
        rig.faults.begin({"fault": "load_cell_spike"}, time.monotonic())
        lines = read_until(port, lambda line: float(line) > 7.0)
        while float(lines[-1]) > 7.0:
            lines.append(port.readline())
    # Of fewer than four readings the mean is that of those there are.
    assert 1 <= sum(float(line) > 7.0 for line in lines) <= 4
    assert near(0.0)(lines[-1])


def test_a_load_cell_that_resets_under_load_says_its_banner_and_has_another_zero(tmp_path):
    rig = made(tmp_path, load_cell={"noise_N": 0.0})
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        port.readline()
        rig.world.force_N = 5.0
        read_until(port, near(5.0))
        rig.faults.begin({"fault": "load_cell_reset"}, time.monotonic())
        read_until(port, lambda line: line.startswith(b"Load cell ready"))
        assert float(port.readline()) == 0.0


def test_pounds_are_an_openscales(tmp_path):
    rig = made(tmp_path, load_cell={"profile": "openscale"})
    with in_background(rig.cell.run()), open_port(rig, "load_cell") as port:
        rig.faults.begin({"fault": "load_cell_lbs"}, time.monotonic())
        read_until(port, lambda line: b",lbs," in line)


PRESSED = [-0.573, -0.201, -0.100, 0.0, 3.142, 0.0]  # 3 mm deep
