"""A capture that is killed at random moments, and resumed each time, is as whole as any other.

Which frames there were and in which press is judged by the emulator's log.
"""

import signal
import subprocess

import numpy as np
import pytest
from driver_process import (
    assert_kept_every_rule,
    assert_stands,
    capture,
    records,
    start_driver,
    stop_reason,
    until,
    wait_for_end,
)
from emulated_rig import Emulated, emulated_rig

from eitskin.capture import journal
from eitskin.data import recording

pytestmark = pytest.mark.rehearsal

KILLS, PLACES, SPEEDUP = 20, 24, 4.0
FAULT = 4
# Stops of a busy machine: the arm stands, and the next run goes on.
LATE = {"robot clock", "robot lost", "robot program", "late", "load cell silent"}
RESUMED = 5  # times at most, from the last kill to the end, where the machine is busy
MOST_EVENTS = 200  # of the emulator, from a run's beginning to its kill: some three presses


def test_twenty_kills_lose_no_sample_and_double_none(tmp_path):
    rng = np.random.default_rng(20)
    with emulated_rig(tmp_path, speedup=SPEEDUP) as rig:
        rig.config["plan"] |= {"angles": PLACES, "probes_mm": [10.0, 15.0], "settle_s": 0.05}
        rig.config["motion"] |= {"search_m_s": 0.001}
        rig.config["board"]["period_s"] = 0.13  # gaps of 0.07 to 0.28 s are frames
        killed = 0
        while killed < KILLS:
            process = start_driver(
                rig, "resume" if (tmp_path / "journal.jsonl").exists() else "run"
            )
            code, output = kill_after(rig, process, int(rng.integers(1, MOST_EVENTS)))
            killed += code == -signal.SIGKILL
            assert code == -signal.SIGKILL or (code == FAULT and stop_reason(rig) in LATE), output
            assert_stands(rig)
        for _ in range(RESUMED):
            code, output = capture(rig, "resume")
            if code == 0 or stop_reason(rig) not in LATE:
                break
        assert code == 0, output
        assert_kept_every_rule(rig)
        assert_whole(rig)


def kill_after(rig: Emulated, process: subprocess.Popen, events: int) -> tuple[int, str]:
    """Kill it once the emulator has logged so many more events; its exit code and what it said."""
    n_events = len(rig.events) + events
    until(rig, lambda: len(rig.events) >= n_events or process.poll() is not None)
    process.kill()
    return wait_for_end(process)


def assert_whole(rig: Emulated) -> None:
    """Every contact once, each sample a frame of its own that the board printed within the one
    press that the contact took, from the first step to the last."""
    journal_records = records(rig)
    finished = journal.finished_frames(journal_records)
    ends = [record["contact"] for record in journal_records if record["kind"] == "end"]
    assert ends == list(range(2 * PLACES))
    frames = recording.read(rig.folder / "it.parquet").frames
    assert len(frames) == len(finished)
    printed = np.array([event["ended"] for event in rig.named("frame")])
    line_numbers = [int(np.searchsorted(printed, record["end_s"])) - 1 for record in finished]
    assert len(set(line_numbers)) == len(line_numbers)
    presses = list(zip(rig.named("touched"), rig.named("released"), strict=True))
    plan = rig.config["plan"]
    for contact in range(2 * PLACES):
        mine = [record for record in finished if record["contact"] == contact]
        phases = [(record["phase"], record["step"]) for record in mine]
        untouched = [("untouched", step) for step in range(plan["untouched_frames"])]
        steps = [("press", step) for step in range(1, len(mine) - len(untouched) + 1)]
        assert phases == untouched + steps
        around = [
            number
            for number, (touched, released) in enumerate(presses)
            if any(touched["t"] < r["end_s"] < released["t"] for r in mine)
        ]
        assert len(around) == 1
        assert mine[-1]["force_N"] - mine[-1]["zero_N"] >= plan["target_N"][0]
