"""The driver in a process of its own, against an emulated rig, and what both of them wrote.

Tests that import this are skipped where the driver's libraries are absent.
"""

import contextlib
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from emulated_rig import Emulated

from eitskin.capture import journal

pytest.importorskip("rtde_control", reason="ur_rtde is not installed: extra `rig`")
pytest.importorskip("serial", reason="pyserial is not installed: extra `rig`")

WAIT_S, POLL_S = 300, 0.05


def start_driver(rig: Emulated, command: str = "run", *options: str) -> subprocess.Popen:
    """`eitskin rig run`, `resume` or `check` in a process of its own."""
    journal_path, recording_path = rig.folder / "journal.jsonl", rig.folder / "it.parquet"
    files = (
        [] if command == "check" else ["--journal", str(journal_path), "--out", str(recording_path)]
    )
    return subprocess.Popen(
        [sys.executable, "-m", "eitskin.cli", "rig", command, str(rig.path), *files, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_end(process: subprocess.Popen) -> tuple[int, str]:
    """Its exit code and all it said."""
    stdout, stderr = process.communicate(timeout=WAIT_S)
    return process.returncode, stdout + stderr


def capture(rig: Emulated, command: str = "run", *options: str) -> tuple[int, str]:
    """`eitskin rig run`, `resume` or `check` to its end."""
    return wait_for_end(start_driver(rig, command, *options))


def records(rig: Emulated) -> list[dict]:
    """The journal's."""
    return journal.read(rig.folder / "journal.jsonl").records


def stop_reason(rig: Emulated) -> str:
    """Why the last run that ended early did."""
    return next(r["reason"] for r in reversed(records(rig)) if r["kind"] == "stop")


def wait_for(rig: Emulated, process: subprocess.Popen, event: str, count: int = 1) -> None:
    """Until the emulator has logged an event `count` times."""
    while len(rig.named(event)) < count:
        with contextlib.suppress(subprocess.TimeoutExpired):
            raise AssertionError(f"it ended before {event}: {process.communicate(timeout=POLL_S)}")


def motions(rig: Emulated) -> list[dict]:
    """The events that tell where the arm is and how it moves, in order."""
    return [event for event in rig.events if event["event"] in ("moving", "stopping", "still")]


def assert_stands(rig: Emulated) -> None:
    """Once both of the driver's connections have ended, the arm comes to rest, where it is not
    sent anywhere any more."""
    until(rig, lambda: len(rig.named("rtde gone")) == len(rig.named("rtde connected")))
    until(rig, lambda: motions(rig)[-1:] == [] or motions(rig)[-1]["velocity"] == [0.0] * 6)


def until(rig: Emulated, condition: Callable[[], bool]) -> None:
    """Wait for something that the emulator logs."""
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s, rig.events[-5:]
        with contextlib.suppress(subprocess.TimeoutExpired):
            raise AssertionError(f"the emulator ended: {rig.process.wait(POLL_S)}")


def assert_kept_every_rule(rig: Emulated) -> None:
    """The emulator saw no rule broken; what the library sends while it reconnects after a reset,
    for recipes that were never set up, is none of the driver's."""
    reset = any(fault["fault"] == "rtde_reset" for fault in rig.named("fault"))
    broken = [v["rule"] for v in rig.named("violation")]
    assert [rule for rule in broken if not (reset and rule == "RTDE protocol")] == []
