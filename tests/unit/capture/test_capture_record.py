"""A journal becomes a recording of the format, and a manifest with hashes."""

import copy
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from eitskin.capture import journal, record
from eitskin.capture.press_plan import contacts, plan_sha256
from eitskin.data import board, check, recording
from eitskin.errors import InputError

PAPER = Path(__file__).parents[3] / "workflow" / "config" / "rig.yaml"
RIG = yaml.safe_load(PAPER.read_text(encoding="utf-8"))["rig"]
RIG["plan"] |= {"radii": 1, "angles": 2, "probes_mm": [7.0, 10.0]}
ZERO_N = 0.02


class Rig:
    """Writes the records of a capture; a clock that goes on, frames that are told apart."""

    frame_s = 0.3  # circular-16's

    def __init__(self, emulated: bool = False):
        self.config = copy.deepcopy(RIG) | {"emulated": emulated}
        self.draw = np.random.default_rng(5)
        self.now_s, self.records = 1000.0, []
        head = {"format": "eit-capture", "version": 1, "config": self.config}
        self.add("capture", **head, plan_sha256=plan_sha256(self.config))
        self.planned = contacts(self.config["plan"])
        self.run = -1

    def add(self, kind: str, **values: object) -> None:
        self.records.append({"kind": kind, **values})

    def begin_run(self, utc: str = "2026-03-01T10:00:00+00:00") -> None:
        self.run += 1
        robot = {"serial": "20201234", "emulated": self.config["emulated"]}
        clocks = {"monotonic_s": self.now_s, "utc": utc}
        may_change = {key: copy.deepcopy(self.config[key]) for key in ("board", "session")}
        may_change["board"]["frame_s"] = self.frame_s
        self.add("run", run=self.run, robot=robot, **may_change, **clocks)

    def frame(self, attempt_key: dict, phase: str, depth_mm: float | None, force_N: float) -> None:
        self.now_s += 1.0
        contact = self.planned[attempt_key["contact"]]
        centre = self.config["pose"]["centre"]
        raw = self.line(self.draw.integers(30, 40, 256))
        pose = [centre[0] + 1e-3 * contact.x_mm, centre[1] + 1e-3 * contact.y_mm, -0.1, 0, 3.1, 0]
        self.add(
            "frame",
            **attempt_key,
            phase=phase,
            depth_mm=depth_mm,
            raw=raw,
            before_s=self.now_s - 0.35,
            end_s=self.now_s,
            end_utc="2026-03-01T10:00:00+00:00",
            force_N=force_N,
            force_spread_N=0.01,
            zero_N=0.0 if phase == "untouched" else ZERO_N,
            pose_before=pose,
            pose_end=pose,
            robot_end_s=self.now_s,
            saturated=0,
        )

    def line(self, steps: np.ndarray) -> str:
        """A frame as circular-16 prints it."""
        steps = np.where(board.read("circular-16").is_recorded, steps, 0)
        return "".join(f"{step * 2.2 / 1024:.4f}, " for step in steps) + "\n"

    def contact(self, number: int, attempt: int = 0, broken: bool = False) -> None:
        attempt_key = {"contact": number, "attempt": attempt, "run": self.run}
        self.add("begin", **attempt_key)
        self.frame(attempt_key, "untouched", None, ZERO_N)
        self.frame(attempt_key, "untouched", None, ZERO_N)
        for depth in (1.0, 2.0, 3.0):
            self.frame(attempt_key, "press", depth, depth + ZERO_N)
        if broken:
            self.add("stop", run=self.run, reason="force", message="too large")
        else:
            self.add("end", **attempt_key, end="target")

    def journal(self, path):
        journal.begin(path, self.records[0])
        writer = journal.Writer(path, journal.read(path))
        writer.append(*self.records[1:])
        writer.close()
        return path


@pytest.fixture
def finished() -> Rig:
    """Four contacts, of which the second was broken off and redone in a second run."""
    rig = Rig()
    rig.begin_run()
    rig.contact(0)
    rig.add("reject", port="board", reason="count", detail="3 values", raw="x", end_s=rig.now_s)
    rig.contact(1, broken=True)
    rig.now_s = 5.0  # the host was started anew
    rig.begin_run("2026-03-01T11:00:00+00:00")
    rig.contact(1, attempt=1)
    rig.contact(2)
    rig.contact(3)
    return rig


def test_a_journal_becomes_a_recording_that_the_format_accepts(finished, tmp_path):
    path = finished.journal(tmp_path / "j.jsonl")
    record.write(path, tmp_path / "r.parquet", tmp_path / "m.json")
    recorded = recording.read(tmp_path / "r.parquet")
    frames = recorded.frames
    assert len(frames) == 20
    assert frames["contact"].dropna().astype(int).tolist() == [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    assert frames["force_N"][2:5].tolist() == pytest.approx([1.0, 2.0, 3.0])
    assert frames["probe_mm"].dropna().unique().tolist() == [7.0, 10.0]
    assert recorded.voltage.shape == (20, 208)
    assert recorded.metadata["source"] == "rig"
    assert recorded.metadata["position_frame"] == "robot"
    for contact in finished.planned:
        touched = frames[frames["contact"] == contact.number]
        np.testing.assert_allclose(touched["x_mm"], contact.x_mm, atol=1e-9)
        np.testing.assert_allclose(touched["y_mm"], contact.y_mm, atol=1e-9)
    assert check.check(recorded).ok


def test_the_voltages_are_the_raw_lines(finished):
    recorded, _ = record.to_recording(finished.records, "j")
    raw = next(r["raw"] for r in finished.records if r["kind"] == "frame")
    values = [float(value) for value in raw.split(",")[:-1]]
    channels = recorded.channels
    assert recorded.voltage[0].tolist() == [values[16 * s + p] for s, _, p, _ in channels]


BENCH = {  # 208 signed ohms a line, numbered
    "electrodes": 16,
    "drive": "adjacent",
    "measurement": "adjacent",
    "order": "drive-plus-ascending-own",
    "line": {"begin": "%d>", "number": "%+.3f", "between": " ", "end": "\r\n"},
    "unit": "ohm",
    "voltage": "signed",
    "range": [-10.0, 10.0],
    "ceiling": 9.0,
    "baud": 9600,
    "period_s": 0.5,
    "frame_s": 0.5,
}


class BenchRig(Rig):
    """A rig with a board of one's own, whose file may be gone by now."""

    frame_s = BENCH["frame_s"]

    def __init__(self):
        super().__init__()
        self.config["board"] = {"port": "/dev/ttyACM1", "profile": "gone.yaml"}
        self.records[0]["board"] = BENCH

    def line(self, steps: np.ndarray) -> str:
        return "7>" + " ".join(f"{0.1 * step - 3.5:+.3f}" for step in steps[:208]) + "\r\n"


def test_a_board_s_description_in_the_journal_reads_its_lines(tmp_path):
    rig = BenchRig()
    rig.begin_run()
    for number in range(4):
        rig.contact(number)
    record.write(rig.journal(tmp_path / "j.jsonl"), tmp_path / "r.parquet", tmp_path / "m.json")
    recorded = recording.read(tmp_path / "r.parquet")
    described_board = board.described("bench", BENCH, "bench.yaml")
    assert recorded.metadata["channels"] == described_board.channels.tolist()
    assert recorded.channels[:2].tolist() == [[0, 1, 2, 3], [0, 1, 3, 4]]
    assert recorded.channels[13].tolist() == [1, 2, 3, 4]
    assert (recorded.metadata["voltage"], recorded.metadata["unit"]) == ("signed", "ohm")
    raw = next(r["raw"] for r in rig.records if r["kind"] == "frame")
    expected = [float(value) for value in raw.removeprefix("7>").split()]
    assert recorded.voltage[0].tolist() == expected
    manifest = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))
    assert manifest["board"] == BENCH
    assert manifest["readings"] == "amplitudes in ohm; so is the skin's current, in A"


def test_time_goes_on_over_a_restart_of_the_host(finished):
    recorded, _ = record.to_recording(finished.records, "j")
    time_s = recorded.frames["time_s"].to_numpy()
    assert time_s[0] == 0.0
    assert time_s[5] - time_s[0] == pytest.approx(3600.0)  # both a second after their run began


@pytest.mark.parametrize("second_C", [26.0, None])
def test_what_may_change_from_run_to_run_is_that_of_a_frames_run(finished, second_C):
    first_run, second_run = (r for r in finished.records if r["kind"] == "run")
    first_run["session"]["room_C"], second_run["session"]["room_C"] = 19.0, second_C
    second_run["board"]["frame_s"] = 0.2
    recorded, _ = record.to_recording(finished.records, "j")
    expected = [19.0] * 5 + [np.nan if second_C is None else second_C] * 15
    np.testing.assert_array_equal(recorded.frames["temperature_C"], expected)
    assert recorded.frames["time_s"][5] == pytest.approx(3600.1)  # it began 0.1 s later
    assert recorded.metadata["frame_s"] == 0.2


def test_a_clock_that_was_set_back_does_not_turn_time_round(finished):
    runs = [r for r in finished.records if r["kind"] == "run"]
    runs[1]["utc"] = "2026-02-01T10:00:00+00:00"
    recorded, _ = record.to_recording(finished.records, "j")
    assert (np.diff(recorded.frames["time_s"]) > 0.0).all()


def test_the_manifest_says_where_every_byte_came_from(finished, tmp_path):
    path = finished.journal(tmp_path / "j.jsonl")
    record.write(path, tmp_path / "r.parquet", tmp_path / "m.json")
    written_manifest = json.loads((tmp_path / "m.json").read_text())
    for key, file in (("recording_sha256", "r.parquet"), ("journal_sha256", "j.jsonl")):
        assert written_manifest[key] == hashlib.sha256((tmp_path / file).read_bytes()).hexdigest()
    assert written_manifest["source"] == "rig"
    assert written_manifest["plan_sha256"] == plan_sha256(finished.config)
    assert written_manifest["contacts"] == 4
    assert len(written_manifest["runs"]) == 2
    assert written_manifest["rejected_lines"] == {"board: count": 1}
    assert [stop["reason"] for stop in written_manifest["stops"]] == ["force"]


def test_the_same_journal_gives_the_same_bytes(finished, tmp_path):
    path = finished.journal(tmp_path / "j.jsonl")
    for name in "ab":
        record.write(path, tmp_path / f"{name}.parquet", tmp_path / f"{name}.json")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.parametrize("record_kind", ["configuration", "robot"])
def test_an_emulated_capture_never_passes_for_a_real_one(finished, record_kind):
    if record_kind == "configuration":
        finished.config["emulated"] = True
    else:
        finished.records[-7]["robot"] = {}  # some other record changes nothing
        [r for r in finished.records if r["kind"] == "run"][1]["robot"]["emulated"] = True
    recorded, left_out = record.to_recording(finished.records, "j")
    assert recorded.metadata["source"] == "emulated rig"
    assert record.manifest(finished.records, recorded, left_out)["source"] == "emulated rig"


def test_a_capture_with_an_unfinished_contact_is_refused(finished):
    finished.records.pop()
    with pytest.raises(InputError, match="found contact 3 of 4 unfinished"):
        record.to_recording(finished.records, "j")


def test_a_raw_line_that_was_changed_is_refused(finished):
    frame = next(r for r in finished.records if r["kind"] == "frame")
    frame["number"] = 7
    frame["raw"] = frame["raw"][8:]
    with pytest.raises(InputError, match="record 7: found count: 255 values"):
        record.to_recording(finished.records, "j")


def test_a_press_of_which_the_force_is_none_is_left_out_and_counted(finished):
    frame = next(r for r in finished.records if r["kind"] == "frame" and r["phase"] == "press")
    frame["force_N"] = ZERO_N - 0.001
    recorded, left_out = record.to_recording(finished.records, "j")
    assert (len(recorded.frames), left_out) == (19, 1)


def test_the_measured_place_counts_not_the_planned_one(finished):
    for frame in (r for r in finished.records if r["kind"] == "frame" and r["contact"] == 0):
        frame["pose_before"] = [frame["pose_before"][0] + 0.002, *frame["pose_before"][1:]]
        frame["pose_end"] = frame["pose_before"]
    recorded, _ = record.to_recording(finished.records, "j")
    assert recorded.frames["x_mm"][2] == pytest.approx(finished.planned[0].x_mm + 2.0)
