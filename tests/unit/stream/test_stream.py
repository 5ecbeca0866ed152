"""`eitskin stream`: a recording, a journal that a kill left, an emulated board and its faults."""

import io
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import streamed_skin as skin
from eitskin import cli
from eitskin.data import board as eit_board
from eitskin.data import recording
from eitskin.errors import InputError
from eitskin.exported import file
from eitskin.exported.predictor import Predictor
from eitskin.stream import sources
from eitskin.stream.judge import Judge
from eitskin.stream.recorder import Recorder, as_recording
from eitskin.stream.run import Tally, run
from eitskin.stream.view import View
from rigsim import faults
from rigsim.eit import text, values
from rigsim.ptys import SerialPort

pytestmark = pytest.mark.xdist_group("streamed")  # one predictor, trained in seconds

pytest.importorskip("serial", reason="pyserial is not installed: extra `rig`")
ROOT = Path(__file__).parents[3]
PATIENCE_S = 120.0  # with a machine that is busy with other things
PLACE = np.array([20.0, -10.0, 6.0])
STATES = np.array([[0.0, 0.0, 0.0]] * 15 + [PLACE] * 10 + [[0.0, 0.0, 0.0]] * 5)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with a model and a recording."""
    monkeypatch.chdir(tmp_path)
    file.write(skin.exported(), "mlp.npz")
    skin.write_recording(tmp_path / "skin.parquet", STATES)
    return tmp_path


def json_lines(capsys):
    """The JSON lines on stdout."""
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_a_recording_is_judged_frame_by_frame(folder, capsys):
    words = ["stream", "skin.parquet", "--model", "mlp.npz", "--fast", "--json"]
    assert cli.main(words) == 0
    lines = json_lines(capsys)
    assert len(lines) == 30
    assert [line["verdict"] for line in lines[:10]] == ["starting"] * 9 + ["no touch"]
    touched = [line for line in lines[15:25] if line["verdict"] == "touch"]
    assert len(touched) >= 8
    for line in touched:
        assert line["x_mm"]["low"] < line["x_mm"]["value"] < line["x_mm"]["high"]
        assert abs(line["x_mm"]["value"] - PLACE[0]) < 10
    assert lines[7]["time_s"] == pytest.approx(0.35)


def test_plain_lines_and_the_sum_of_it(folder, capsys):
    assert cli.main(["stream", "skin.parquet", "--model", "mlp.npz", "--fast"]) == 0
    printed = capsys.readouterr()
    assert "starting · leave the skin untouched" in printed.out
    assert "· touch · x " in printed.out and " ± " in printed.out
    assert "\r" not in printed.out
    assert printed.err.startswith("frames: 9 starting, ") and "99 % within" in printed.err


def test_a_recording_of_the_stream_is_read_again(folder, capsys):
    words = ["stream", "skin.parquet", "--model", "mlp.npz", "--fast", "--out", "out.parquet"]
    assert cli.main(words) == 0
    streamed, recorded = recording.read("out.parquet"), recording.read("skin.parquet")
    np.testing.assert_allclose(streamed.readings, recorded.readings)
    assert "states estimated by mlp of streamed" in streamed.metadata["source"]
    assert set(streamed.frames["note_verdict"]) >= {"starting", "no touch", "touch"}
    assert not Path("out.jsonl").exists()
    assert cli.main(["check", "out.parquet"]) in (0, 2)


def test_a_recording_comes_at_its_time_stamps(folder, capsys):
    start = time.perf_counter()
    assert cli.main(["stream", "skin.parquet", "--model", "mlp.npz"]) == 0
    assert time.perf_counter() - start > 29 * 0.05


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"channels": skin.TABLE[::-1].tolist()}, "channels: found 208 others, expected those of"),
        ({"voltage": "signed"}, "voltage: found 'signed', expected those of streamed"),
        ({"unit": "ohm"}, "unit: found 'ohm'"),
    ],
)
def test_a_recording_of_another_board_is_refused(folder, capsys, changed, message):
    skin.write_recording(folder / "other.parquet", STATES, **changed)
    assert cli.main(["stream", "other.parquet", "--model", "mlp.npz", "--fast"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith(f"other.parquet: {message}")


def test_a_touch_from_the_start_and_a_file_that_is_no_model_are_refused(folder, capsys):
    skin.write_recording(folder / "touched.parquet", STATES[::-1][5:])
    assert cli.main(["stream", "touched.parquet", "--model", "mlp.npz", "--fast"]) == 1
    assert "expected an untouched frame first" in capsys.readouterr().err
    assert cli.main(["stream", "skin.parquet", "--model", "skin.parquet", "--fast"]) == 1
    assert "expected an exported predictor" in capsys.readouterr().err


def test_an_earlier_journal_is_not_written_over(folder, capsys):
    words = ["stream", "skin.parquet", "--model", "mlp.npz", "--fast", "--out", "out.parquet"]
    Path("out.jsonl").write_text("{}", encoding="utf-8")
    assert cli.main(words) == 1
    assert "out.jsonl: line 1: found no record of a stream" in capsys.readouterr().err
    Path("out.jsonl").unlink()
    killed = Recorder("out.parquet", skin.exported().header, False, "a test", "board")
    killed._writer.append({"kind": "frame"})
    killed._writer.close()
    assert cli.main(words) == 1
    command = "eitskin stream out.jsonl --model MODEL --fast --out out.parquet"
    expected = f"found an earlier stream's journal, expected none; `{command}` makes"
    assert expected in capsys.readouterr().err


def running(*words):
    """The command in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "workflow")}
    return subprocess.Popen(
        [sys.executable, "-m", "eitskin.cli", "stream", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def test_a_killed_stream_leaves_a_journal_that_is_streamed_again(folder, capsys):
    long = np.repeat(STATES[:1], 2000, axis=0)
    skin.write_recording(folder / "long.parquet", long)
    streaming = running("long.parquet", "--model", "mlp.npz", "--json", "--out", "out.parquet")
    for _ in range(40):
        assert streaming.stdout.readline()
    streaming.send_signal(signal.SIGKILL)
    streaming.communicate(timeout=60)
    assert not Path("out.parquet").exists()
    assert len(as_recording("out.jsonl").frames) >= 20
    words = ["stream", "out.jsonl", "--model", "mlp.npz", "--fast", "--out", "out.parquet"]
    assert cli.main(words) == 0
    assert len(recording.read("out.parquet").frames) >= 20
    assert Path("out.jsonl").exists() and not Path("out.again.jsonl").exists()


@pytest.mark.parametrize(
    ("out_path", "message"),
    [
        ("out.jsonl", "out.jsonl: --out: found the ending '.jsonl', expected '.parquet'"),
        ("out.csv", "out.csv: --out: found the ending '.csv', expected '.parquet'"),
        ("./skin.parquet", "./skin.parquet: --out: found the source itself, expected another file"),
    ],
)
def test_an_out_that_would_spoil_something_is_refused(folder, capsys, out_path, message):
    original_bytes = Path("skin.parquet").read_bytes()
    assert (
        cli.main(["stream", "skin.parquet", "--model", "mlp.npz", "--fast", "--out", out_path]) == 1
    )
    assert capsys.readouterr().err.strip() == message
    assert Path("skin.parquet").read_bytes() == original_bytes


def test_a_refused_stream_leaves_no_recording(folder, capsys):
    pressed = skin.readings(np.array([PLACE] * 10), np.random.default_rng(1))
    skin.write_recording(folder / "held.parquet", STATES, lambda v: np.vstack([pressed, v[10:]]))
    words = ["stream", "held.parquet", "--model", "mlp.npz", "--fast", "--out", "out.parquet"]
    assert cli.main(words) == 1
    expected = "held.parquet: opening frames: found a touch like those trained on"
    assert capsys.readouterr().err.startswith(expected)
    assert not list(folder.glob("out*"))


def test_a_signal_while_frames_are_written_loses_and_doubles_none(folder, monkeypatch):
    recorder = Recorder("out.parquet", skin.exported().header, False, "a test", "board")
    voltage = skin.readings(np.zeros((3, 3)), np.random.default_rng(1))
    for number, reading in enumerate(voltage):
        recorder._pending_records.append(
            {"kind": "frame", "time_s": 0.1 * number, "verdict": "no touch"}
        )
        recorder._pending_records[-1] |= {"reading": reading.tolist(), "state": None, "half": None}
        recorder._pending_records[-1]["lost"] = []
        recorder._n_decided += 1
    fsync = os.fsync

    def interrupted(number):
        fsync(number)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        recorder.flush()
    monkeypatch.setattr(os, "fsync", fsync)
    recorder.close()
    assert recording.read("out.parquet").frames["time_s"].tolist() == [0.0, 0.1, 0.2]


def test_what_cannot_be_told_is_neither_touched_nor_untouched_in_a_recording(folder, capsys):
    def palm(voltage):
        return voltage * np.where(np.arange(len(voltage)) < 25, 1.0, 0.95)[:, None]

    skin.write_recording(folder / "palm.parquet", STATES, palm)
    words = ["stream", "palm.parquet", "--model", "mlp.npz", "--fast", "--out", "out.parquet"]
    assert cli.main(words) == 0
    frames = recording.read("out.parquet").frames
    assert "cannot tell" not in set(frames["note_verdict"]) and len(frames) <= 25
    touched = frames[frames["touch"]]
    np.testing.assert_allclose(touched["note_estimate_force_N"], touched["force_N"])


def test_a_stream_that_was_killed_before_its_first_frame_is_in_nobodys_way(folder):
    header = skin.exported().header
    killed_recorder = Recorder("out.parquet", header, False, "a test", "board")
    with pytest.raises(InputError, match="another capture's lock"):
        Recorder("out.parquet", header, False, "a test", "board")
    killed_recorder._writer.close()  # as a kill does
    Recorder("out.parquet", header, False, "a test", "board").discard()
    assert not list(folder.glob("out*"))


def test_where_nothing_could_be_told_the_stream_ends_without_a_recording(folder, capsys):
    """A recording of differences has no opening frames to hold the skin by."""
    odd = folder / "odd.parquet"
    skin.write_recording(odd, STATES, lambda voltage: -voltage, values="difference")
    words = ["stream", "odd.parquet", "--model", "mlp.npz", "--fast", "--out", "out.parquet"]
    assert cli.main(words) == 0
    assert f"{len(STATES)} cannot tell" in capsys.readouterr().err
    assert not list(folder.glob("out*"))


def test_latencies_are_the_latest(monkeypatch):
    tally = Tally()
    tally.latency_s.extend(range(100_002))
    assert len(tally.latency_s) == 100_000 and tally.latency_s[-1] == 100_001


def test_a_board_s_model_of_other_channels_names_its_file(folder, capsys):
    exported = skin.exported()
    header = exported.header | {"dataset": exported.header["dataset"] | {"voltage": "signed"}}
    file.write(replace(exported, header=header), "signed.npz")
    assert cli.main(["stream", "/dev/null", "--model", "signed.npz"]) == 1
    assert capsys.readouterr().err.startswith("signed.npz: voltage: found signed V of streamed")


BENCH = """
electrodes: 16
drive: adjacent
measurement: adjacent
line: {begin: "EIT:", number: "%.2f", between: " ", end: "\\r\\n"}
factor: 0.001
voltage: magnitude
range: [0, 1650]
ceiling: 1500
baud: 250000
period_s: 0.1
frame_s: 0.1
"""


class Board(threading.Thread):
    """An emulated board: its port, its lines, and what a fault makes of each."""

    spoilers = faults.Faults.__new__(faults.Faults)  # what a line becomes; no rig around it

    def __init__(self, folder, spoil, profile):
        super().__init__(daemon=True)
        self.eit_board = eit_board.read(profile)
        self.spoilers.board = self
        self.port, self.spoil, self.over = SerialPort(folder / "board"), spoil, False
        self.spoilers.rng = np.random.default_rng(1)

    def run(self):
        draw = np.random.default_rng(2)
        for number in itertools.count():
            while not self.over and not self.port.open_by_host():
                time.sleep(0.01)
            if self.over:
                break
            state = PLACE if number % 40 >= 25 else np.zeros(3)
            numbers = values(skin.readings(state[None], draw)[0], self.eit_board)
            data = self.spoil(self, number, numbers, text(numbers, self.eit_board))
            while data and not self.over and self.port.plugged:
                data = data[self.port.write(data) :]
            time.sleep(0.01)


@pytest.fixture
def board(folder):
    """Starts an emulated board whose lines are spoilt."""
    started = []

    def start(spoil, profile="circular-16"):
        started.append(Board(folder, spoil, profile))
        started[0].start()

    yield start
    for emulated in started:
        emulated.over = True
        emulated.join()
        emulated.port.unplug()


def streamed(enough, profile=None):
    """What a stream of the board says until that is enough."""
    exported, output = skin.exported(), io.StringIO()
    trained_on = exported.header["dataset"]
    source = sources.board_source("board", profile, None, trained_on, sources.Stop())
    predictor, give_up = Predictor(exported), time.monotonic() + PATIENCE_S

    def lines():
        return [json.loads(line) for line in output.getvalue().splitlines()]

    def until_enough():
        for event in source.events:
            yield event
            if enough(lines()):
                return
            assert time.monotonic() < give_up, lines()[-3:]

    view = View(predictor.targets, True, output)
    try:
        run(replace(source, events=until_enough()), Judge(predictor), view, None, Tally())
    finally:
        source.events.close()
    return lines()


def fault(name, line_numbers):
    """Lines that a fault of the emulated rig's spoils, those of the numbers `line_numbers`."""

    def spoil(board, number, line_V, line):
        return getattr(board.spoilers, f"_{name}")(line_V, line) if number in line_numbers else line

    return spoil


def kinds(lines):
    return [line.get("verdict", line.get("trouble")) for line in lines]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("garbled", "a line refused, "),
        ("short", "a line refused, count: "),
        ("joined", "a line refused, count: 512 values"),
        ("driven", "a line refused, driven pair: "),
    ],
)
def test_a_bad_line_is_refused_and_the_next_frame_is_judged(board, name, message):
    board(fault(name, {20, 30}))
    lines = streamed(lambda lines: len(lines) >= 36)
    troubles = [words for words in kinds(lines) if words.startswith("a line refused")]
    assert len(troubles) == 2 and all(words.startswith(message) for words in troubles)
    assert kinds(lines).count("touch") >= 5 and kinds(lines).count("no touch") >= 8


def test_saturated_readings_are_left_out_and_said(board):
    board(fault("saturated", range(15, 20)))
    lines = streamed(lambda lines: len(lines) >= 22)
    left_out = [line.get("left_out", 0) for line in lines]
    assert max(left_out) >= 20 and left_out[-1] == 0


def test_lost_frames_leave_a_gap_and_nothing_else(board):
    board(lambda board, number, line_V, line: b"" if 14 <= number < 20 else line)
    lines = streamed(lambda lines: len(lines) >= 28)
    left_out = sum(line.get("left_out", 0) for line in lines)  # on a busy machine
    assert kinds(lines[:19]).count("no touch") >= 9 - left_out
    assert kinds(lines[19:]).count("touch") >= 8 - left_out


def test_a_board_that_is_unplugged_and_back(board):
    def unplug(board, number, line_V, line):
        if number == 20:
            board.port.unplug()
            time.sleep(0.3)
            board.port.plug_in()
            return b""
        return line

    board(unplug)
    lines = streamed(lambda lines: len(lines) >= 35)
    assert "board is gone" in kinds(lines)
    after = kinds(lines)[kinds(lines).index("board is gone") :]
    assert {"no touch", "touch"} & set(after)


def test_a_board_that_repeats_a_frame_is_said_to_and_judged_no_more(board):
    frozen = []

    def freeze(board, number, line_V, line):
        if 14 <= number < 24:
            frozen.append(line)
            return frozen[0]
        return line

    board(freeze)
    lines = kinds(streamed(lambda lines: len(lines) >= 28))
    troubles = [line for line in lines if "repeats itself" in line]
    assert troubles[0].endswith(": 5 frames alike to the last digit") and len(troubles) == 6
    assert {"no touch", "touch"} & set(lines[lines.index(troubles[-1]) + 1 :])


def test_a_reader_that_stalls_is_told_how_late_each_frame_is(board):
    board(lambda board, number, line_V, line: line)
    streaming = running("board", "--model", "mlp.npz", "--json")
    for _ in range(12):
        assert json.loads(streaming.stdout.readline())["late_s"] >= 0.0
    time.sleep(2.0)
    delayed = [json.loads(streaming.stdout.readline()) for _ in range(6)]
    streaming.kill()
    streaming.communicate(timeout=60)
    written_s = delayed[0]["time_s"]  # before the reader stalled
    assert min(line["time_s"] + line["late_s"] for line in delayed[1:]) > written_s + 1.0


def test_a_board_of_another_kind_is_refused(board):
    board(fault("long", range(100)))
    with pytest.raises(InputError) as refused:
        streamed(lambda lines: len(lines) > 20)
    expected = "board: 5 lines: found count: 768 values, expected 256, expected a frame of circ"
    assert str(refused.value).startswith(expected)


def test_a_board_s_stream_ends_with_ctrl_c_and_leaves_a_recording(board):
    board(lambda board, number, line_V, line: line)
    streaming = running("board", "--model", "mlp.npz", "--json", "--out", "out.parquet")
    for _ in range(30):
        assert streaming.stdout.readline()
    streaming.send_signal(signal.SIGINT)
    _, err = streaming.communicate(timeout=60)
    assert streaming.returncode == 0, err
    assert err.startswith("frames: 9 starting")
    streamed = recording.read("out.parquet")
    assert streamed.metadata["source"].startswith("circular-16 at board; states")
    assert streamed.frames["touch"].any() and not streamed.frames["touch"].all()


def test_a_board_of_one_s_own_is_its_file(board, capsys):
    Path("bench.yaml").write_text(BENCH, encoding="utf-8")
    board(lambda board, number, numbers, line: line, "bench.yaml")
    lines = streamed(lambda lines: len(lines) >= 36, "bench.yaml")
    assert kinds(lines).count("touch") >= 5 and kinds(lines).count("no touch") >= 8
    touched = next(line for line in lines if line.get("verdict") == "touch")
    assert abs(touched["x_mm"]["value"] - PLACE[0]) < 10
    with pytest.raises(InputError, match="5 lines: found form: it begins b'EIT:"):
        streamed(lambda lines: False)
    Path("other.yaml").write_text(
        BENCH.replace("electrodes: 16", "electrodes: 8"), encoding="utf-8"
    )
    with pytest.raises(InputError, match=r"those of a board: other.yaml; --board names another"):
        streamed(lambda lines: False, "other.yaml")
