"""The driver against the emulated rig, through the real libraries: a capture, and what goes wrong.

What the robot did is judged by the emulator's log, never by the driver's word.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from driver_process import (
    assert_kept_every_rule,
    assert_stands,
    capture,
    motions,
    records,
    start_driver,
    stop_reason,
    wait_for,
    wait_for_end,
)
from emulated_rig import CENTRE, CLEARANCE_M, HARD_N, Emulated, emulated_rig

from eitskin.data import recording

pytestmark = pytest.mark.rehearsal

FAULT = 4
SURFACE_M, STEP_MM = CENTRE[2] - CLEARANCE_M, 1.0


@pytest.fixture
def rig(tmp_path) -> Iterator[Emulated]:
    """An emulated CB3 rig."""
    with emulated_rig(tmp_path) as emulated:
        yield emulated


def assert_stopped(rig: Emulated, fault: dict, lifted: bool) -> None:
    """The arm went no deeper than the step under way, and stands: above the skin where lifted."""
    depths = [1e3 * (SURFACE_M - e["pose"][2]) for e in motions(rig) if e["t"] > fault["t"]]
    assert max(depths, default=0.0) <= fault["now"]["depth_mm"] + STEP_MM + 0.05
    last_motion = motions(rig)[-1]
    assert last_motion["velocity"] == [0.0] * 6
    if lifted:
        assert last_motion["pose"][2] == pytest.approx(CENTRE[2], abs=1e-4)
    assert max(event.get("largest_N", 0.0) for event in rig.events) < HARD_N
    assert_kept_every_rule(rig)


def test_three_contacts(rig):
    code, output = capture(rig)
    assert code == 0, output
    assert_kept_every_rule(rig)
    recorded = recording.read(rig.folder / "it.parquet")
    frames = recorded.frames
    assert recorded.metadata["source"] == "emulated rig"
    assert frames["contact"].dropna().unique().tolist() == [0, 1, 2]
    assert (frames[~frames["touch"]]["note_phase"] == "untouched").all()
    assert (~frames["touch"]).sum() == 6
    last_force = frames[frames["touch"]].groupby("contact")["force_N"].last()
    assert (last_force >= 2.0).all()
    manifest = json.loads((rig.folder / "it.manifest.json").read_text())
    assert manifest["source"] == "emulated rig"
    assert manifest["ends"] == {"target": 3}
    assert manifest["runs"][0]["robot"]["emulated"]


def test_every_frame_began_after_the_arm_had_settled(rig):
    code, output = capture(rig)
    assert code == 0, output
    printed = rig.named("frame")
    for frame in (r for r in records(rig) if r["kind"] == "frame"):
        measured_mask = [f for f in printed if f["ended"] <= frame["end_s"]][-1]
        assert measured_mask["began"] >= frame["settled_s"]
        assert measured_mask["force_N"] == pytest.approx(frame["force_N"], abs=0.05)
        motion_events = [e for e in rig.events if e["event"] in ("moving", "still")]
        events_before = [e for e in motion_events if e["t"] <= measured_mask["ended"]]
        assert not events_before or events_before[-1]["event"] == "still"


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("load_cell_silent", "load cell silent"),
        ("load_cell_nan", "load cell rejects"),
        ("load_cell_frozen", "load cell frozen"),
        ("load_cell_spike", "force jump"),  # a running mean of four makes 30 N 7.5
        ("load_cell_reset", "load cell restart"),
        ("load_cell_unplugged", "load cell lost"),
        ("board_silent", "late"),
        ("board_unplugged", "board lost"),
    ],
)
def test_a_device_that_fails_in_a_press(rig, fault, reason):
    rig.begin(fault=fault, contact=1, depth_mm=0.8)
    code, output = capture(rig)
    assert (code, stop_reason(rig)) == (FAULT, reason), output
    assert output.strip().endswith("; lifted off")
    assert_stopped(rig, rig.named("fault")[0], lifted=True)


@pytest.mark.parametrize(
    ("fault", "reasons", "lifted"),
    [
        ("rtde_stalled", {"robot clock"}, False),
        ("rtde_reset", {"robot lost", "robot clock"}, False),
        ("protective_stop", {"robot safety", "robot program"}, False),
        ("emergency_stop", {"robot safety", "robot program", "robot mode"}, False),
        ("program_killed", {"robot program"}, True),
    ],
)
def test_a_robot_that_fails_in_a_press(rig, fault, reasons, lifted):
    rig.begin(fault=fault, contact=1, depth_mm=0.8, moving=True)
    code, output = capture(rig)
    assert code == FAULT, output
    assert stop_reason(rig) in reasons
    assert_stopped(rig, rig.named("fault")[0], lifted)
    assert ("lift by hand" in output) == (not lifted)


def test_a_program_that_ends_while_the_arm_stands_is_started_again_to_lift(rig):
    rig.begin(fault="program_killed", contact=1, depth_mm=0.8, moving=False)
    code, output = capture(rig)
    assert (code, stop_reason(rig)) == (FAULT, "robot program"), output
    assert output.strip().endswith("; lifted off")
    assert_stopped(rig, rig.named("fault")[0], lifted=True)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ({"fault": "load_cell_stuck"}, "load cell deaf"),
        ({"fault": "load_cell_stuck", "size": 0.05}, "load cell deaf"),
        ({"fault": "load_cell_saturated", "size": 1.5}, "load cell deaf"),
        ({"fault": "load_cell_drift", "size": -5.0}, "load cell deaf"),
        ({"fault": "board_frozen"}, "board frozen"),
    ],
)
def test_a_press_that_a_device_does_not_follow_is_not_finished(rig, fault, reason):
    rig.config["plan"]["target_N"] = [8.0, 9.0]
    rig.begin(**fault, contact=2, depth_mm=1.5)
    code, output = capture(rig)
    assert (code, stop_reason(rig)) == (FAULT, reason), output
    assert [r["contact"] for r in records(rig) if r["kind"] == "end"] == [0]
    limits, plan = rig.config["limits"], rig.config["plan"]
    deaf_N = limits["stiffness_N_per_mm"] * (limits["rise_mm"] + plan["step_mm"])
    largest_N = max(e.get("largest_N", 0.0) for e in rig.events)
    assert largest_N < plan["target_N"][1] + deaf_N
    assert rig.named("still")[-1]["pose"][2] == pytest.approx(CENTRE[2], abs=1e-4)
    assert_kept_every_rule(rig)


@pytest.mark.parametrize("fault", ["load_cell_offset", "load_cell_drift"])
def test_a_load_cell_whose_zero_moves(rig, fault):
    rig.begin(fault=fault, contact=1, depth_mm=0.8)
    code, output = capture(rig)
    assert (code, stop_reason(rig)) == (FAULT, "load cell zero"), output
    assert rig.named("touched")[-1]["contact"] == 1
    assert [r for r in records(rig) if r["kind"] == "end"] == []
    assert rig.named("still")[-1]["pose"][2] == pytest.approx(CENTRE[2], abs=1e-4)
    assert_kept_every_rule(rig)


def test_lines_that_are_no_frames_are_counted_kept_and_never_used(rig):
    faults = ("short", "long", "joined", "garbled", "driven", "duplicated")
    for place, fault in enumerate(faults):  # two in each contact, at its first and second step
        rig.begin(fault=f"board_{fault}", contact=1 + place // 2, depth_mm=0.9 + place % 2)
    code, output = capture(rig)
    assert code == 0, output
    rejects = [r["reason"] for r in records(rig) if r["kind"] == "reject"]
    assert len(rejects) == 5  # of the duplicated line both are whole, and neither is used
    assert {"count", "driven pair"} <= set(rejects)
    assert len(recording.read(rig.folder / "it.parquet").frames) == sum(
        r["kind"] == "frame" for r in records(rig)
    )


def test_frames_of_a_saturated_board_are_kept_and_said_to_be(rig):
    rig.begin(fault="board_saturated", contact=2, depth_mm=0.9, count=5)
    code, output = capture(rig)
    assert code == 0, output
    assert_kept_every_rule(rig)
    printed = rig.named("frame")
    assert sum(not frame["as_read"] for frame in printed) == 5
    frame_records = [record for record in records(rig) if record["kind"] == "frame"]
    its_own = [
        [p for p in printed if p["ended"] <= record["end_s"]][-1] for record in frame_records
    ]
    assert [record["saturated"] > 0 for record in frame_records] == [
        not p["as_read"] for p in its_own
    ]
    spoilt = {record["contact"] for record in frame_records if record["saturated"]}
    assert spoilt == {1}  # counted from 0
    frames = recording.read(rig.folder / "it.parquet").frames
    assert set(frames.loc[frames["note_saturated"] > 0, "contact"]) == spoilt


def test_a_load_cell_in_pounds_is_never_taken_for_one_in_kilograms(tmp_path):
    with emulated_rig(tmp_path, profile="openscale", baud=9600) as rig:
        rig.begin(fault="load_cell_lbs")
        code, output = capture(rig)
        assert (code, rig.named("moveL")) == (1, []), output
        assert "0 readings in 5 s" in output and "pounds; set the OpenScale to kg" in output
        rig.begin(fault="load_cell_lbs", end=True)
        rig.begin(fault="load_cell_lbs", contact=1, depth_mm=0.8)
        code, output = capture(rig)
        assert (code, stop_reason(rig)) == (FAULT, "load cell rejects"), output
        assert output.strip().endswith("; lifted off")
        assert_stopped(rig, rig.named("fault")[1], lifted=True)


@pytest.mark.parametrize("fault", ["rtde_mute", "rtde_refused", "rtde_in_use"])
def test_a_robot_that_cannot_be_had_is_one_message_and_nothing_moves(rig, fault):
    rig.begin(fault=fault)
    code, output = capture(rig)
    assert code == 1
    assert output.count("\n") == 1
    assert "robot" in output
    assert rig.named("moveL") == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_and_lifts(rig, number):
    process = start_driver(rig)
    wait_for(rig, process, "touched")
    process.send_signal(number)
    code, output = wait_for_end(process)
    assert code == 128 + number, output
    assert stop_reason(rig) == "signal"
    assert rig.named("still")[-1]["pose"][2] == pytest.approx(CENTRE[2], abs=1e-4)
    assert_kept_every_rule(rig)


def test_sigterm_of_a_command_with_its_rig_lifts_before_the_rig_ends(tmp_path):
    with emulated_rig(tmp_path) as rig:
        driver = ["rig", "run", str(rig.path), "--journal", str(tmp_path / "journal.jsonl")]
    during = ["-m", "rigsim.during", str(tmp_path / "rigsim.yaml")]
    process = subprocess.Popen(
        [sys.executable, *during, sys.executable, "-m", "eitskin.cli", *driver],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(rig, process, "touched")
    process.send_signal(signal.SIGTERM)
    code, output = wait_for_end(process)
    assert code == 128 + signal.SIGTERM, output
    assert output.strip().endswith("; lifted off")
    assert rig.named("still")[-1]["pose"][2] == pytest.approx(CENTRE[2], abs=1e-4)
    assert rig.events[-1]["event"] == "end" and rig.events[-1]["force_N"] == 0.0


def test_a_killed_host_leaves_an_arm_that_stands_and_a_journal_that_goes_on(rig):
    process = start_driver(rig)
    wait_for(rig, process, "touched", count=2)
    process.kill()
    wait_for_end(process)
    assert_stands(rig)
    code, output = capture(rig, "resume")
    assert code == 0, output
    assert_kept_every_rule(rig)
    ends = [r["contact"] for r in records(rig) if r["kind"] == "end"]
    assert ends == [0, 1, 2]
    frames = recording.read(rig.folder / "it.parquet").frames
    pressed = frames[frames["touch"]].groupby("contact")["depth_mm"]
    assert (pressed.count() == pressed.nunique()).all()


def worker_of(process: subprocess.Popen) -> int:
    """The process that holds the robot's library."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for child in map(int, children):
        if b"robot_worker" in Path(f"/proc/{child}/cmdline").read_bytes():
            return child
    raise AssertionError(f"no worker among {children}")


def test_a_worker_that_dies_in_a_press_leaves_an_arm_that_stands(rig):
    process = start_driver(rig)
    wait_for(rig, process, "touched")
    os.kill(worker_of(process), signal.SIGKILL)
    code, output = wait_for_end(process)
    assert (code, stop_reason(rig)) == (FAULT, "robot lost"), output
    assert "lift by hand" in output
    assert_stands(rig)
    assert_kept_every_rule(rig)


@pytest.mark.parametrize("watchdog_Hz", [10.0, 2.5])
def test_a_driver_that_is_gone_altogether_is_missed_by_the_controller(rig, watchdog_Hz):
    rig.config["limits"]["watchdog_Hz"] = watchdog_Hz
    process = start_driver(rig)
    wait_for(rig, process, "moving", count=2)  # the search, at 2 mm/s
    process.send_signal(signal.SIGSTOP)
    os.kill(worker_of(process), signal.SIGKILL)
    wait_for(rig, process, "still", count=2)
    process.kill()
    wait_for_end(process)
    assert [e["frequency"] for e in rig.named("setWatchdog")] == [watchdog_Hz]
    stopped = rig.named("program stopped")[-1]
    assert stopped["reason"] == "watchdog"
    assert 1.0 / watchdog_Hz < stopped["longest_silence_s"] < 1.0 / watchdog_Hz + 0.03
    assert rig.named("still")[-1]["pose"][2] > rig.named("moveL")[-1]["target"][2]
    assert_kept_every_rule(rig)


def test_a_host_that_hangs_in_a_move_leaves_an_arm_that_stands(rig):
    process = start_driver(rig)
    wait_for(rig, process, "moving", count=2)  # the search, at 2 mm/s
    process.send_signal(signal.SIGSTOP)
    wait_for(rig, process, "stopL")
    wait_for(rig, process, "still", count=2)
    process.send_signal(signal.SIGCONT)
    code, output = wait_for_end(process)
    assert code == FAULT, output
    assert_kept_every_rule(rig)


def test_another_robot_another_load_cell_and_probes_that_a_command_changes(tmp_path):
    with emulated_rig(tmp_path, "e", profile="openscale", baud=9600) as rig:
        rig.config["plan"] |= {"angles": 1, "probes_mm": [7.0, 15.0], "untouched_frames": 1}
        code, output = capture(rig)
        assert code == 0, output
        assert_kept_every_rule(rig)
        assert [touched["probe_mm"] for touched in rig.named("touched")] == [7.0, 15.0]
        frames = recording.read(rig.folder / "it.parquet").frames
        assert frames["probe_mm"].dropna().unique().tolist() == [7.0, 15.0]


def test_probes_that_a_person_changes_end_a_run_above_the_skin(rig):
    rig.config["plan"] |= {"angles": 1, "probes_mm": [10.0, 15.0], "untouched_frames": 1}
    rig.config["probe_change"] = None
    code, output = capture(rig)
    assert (code, rig.named("moveL")) == (1, []), output
    assert "expected the probe of 10 mm" in output
    code, output = capture(rig, "run", "--probe", "10")
    assert code == 3, output
    assert "mount the probe of 15 mm" in output
    assert rig.named("still")[-1]["pose"][2] == pytest.approx(CENTRE[2], abs=1e-4)
    (rig.folder / "probe_mm").write_text("15")
    code, output = capture(rig, "resume", "--probe", "15")
    assert code == 0, output
    assert [touched["probe_mm"] for touched in rig.named("touched")] == [10.0, 15.0]
    assert_kept_every_rule(rig)


def test_a_resumed_plan_must_be_the_one_that_was_begun(rig):
    rig.config["plan"] |= {"angles": 1, "untouched_frames": 1}
    assert capture(rig)[0] == 0
    rig.config["plan"]["step_mm"] = 0.5
    code, output = capture(rig, "resume")
    assert code == 1
    assert "found another rig or plan" in output


def test_a_real_rig_is_no_emulated_one_and_the_other_way_round(rig):
    rig.config["emulated"] = False
    code, output = capture(rig)
    assert (code, rig.named("moveL")) == (1, [])
    assert "not what the configuration says, real" in output


def test_check_says_what_is_there_and_moves_nothing(rig):
    process = start_driver(rig, "check")
    code, output = wait_for_end(process)
    assert code == 0, output
    expected = ["plan", "robot", "dashboard", "watchdog", "load cell", "board"]
    assert [line.partition(":")[0] for line in output.splitlines()] == [
        f"ok  {name}" for name in expected
    ], output
    rig.begin(fault="board_silent")
    rig.begin(fault="load_cell_nan")
    rig.begin(fault="emergency_stop")
    code, output = wait_for_end(start_driver(rig, "check"))
    assert code == 2, output
    findings = dict(line.split(": ", 1) for line in output.splitlines())
    assert "an emergency stop" in findings["NOT robot"]
    assert findings["NOT load cell"].startswith("0 readings in 5 s")
    assert "b'nan" in findings["NOT load cell"]
    assert findings["NOT board"].startswith("0 frames in 5 s")
    assert rig.named("moveL") == []
