"""A sweep is measured by the clock, in a copy of the workflow, and says where it fails."""

import subprocess
import time
from pathlib import Path

import pytest

from benchmark import sweep


def test_a_sweep_that_fails_says_why(monkeypatch):
    failed = subprocess.CompletedProcess([], 1, "", "no such rule")
    monkeypatch.setattr(sweep.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(RuntimeError, match="on 2 slots failed: no such rule"):
        sweep.sweep(2)


def test_the_workflow_is_run_in_a_copy_on_so_many_slots(monkeypatch):
    commands = []

    def run(command, cwd, **_):
        assert (Path(cwd) / "workflow" / "rules" / "calibrate.smk").is_file()
        commands.append(command)
        for word in command[command.index("--") + 1 :]:
            file = Path(cwd) / word
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text("kind,seed\nnull,1\nnull,2\n")
        time.sleep(0.2)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(sweep.subprocess, "run", run)
    rate, _ = sweep.sweep(4)
    assert 0.0 < rate < 3600.0 * 2 * sweep.BATCHES / 0.2
    assert commands[0][commands[0].index("--cores") + 1] == "4"


def test_slots_stand_beside_as_many_times_what_one_does(monkeypatch):
    monkeypatch.setattr(sweep, "sweep", lambda slots: (100.0 * min(slots, 2), 20.0))
    ratios = {row["name"]: row["ratio"] for row in sweep.swept(1)}
    assert ratios["sweep, 1 slot"] == ratios["sweep, 2 slots"] == 1.0
    assert ratios["sweep, 4 slots"] == 0.5
    assert ratios["sweep, 4 slots, a diagnosis"] == 1.0
