"""A row holds what every run took, of which commit, and where."""

import os
import subprocess

import pytest

from benchmark import rows


def test_a_row_is_the_median_of_its_runs_beside_a_limit():
    row = rows.row("perturbed", "s", (3.0, 9.0, 4.0), "limit", [2.0])
    assert (row["ours"], row["peer"], row["ratio"], row["runs"]) == (4.0, 2.0, 2.0, 3)
    assert (row["ours_runs"], row["peer_runs"]) == ([3.0, 9.0, 4.0], [2.0])


def test_a_row_can_be_the_worst_of_its_runs():
    row = rows.row("diagnosed, worst", "s", [3.0, 9.0, 4.0], "limit", [3.0], max)
    assert (row["ours"], row["ratio"]) == (9.0, 3.0)


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository of one commit."""
    (tmp_path / "workflow").mkdir()
    (tmp_path / "workflow" / "code.py").write_text("")
    (tmp_path / "README.md").write_text("")
    named = ("-c", "user.name=a", "-c", "user.email=a@b")
    for words in (("init", "-q"), ("add", "."), (*named, "commit", "-q", "-m", "first")):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    monkeypatch.setattr(rows, "ROOT", tmp_path)
    return tmp_path


def test_the_commit_is_told_and_whether_what_is_measured_was_edited(checkout):
    clean = rows.commit()
    assert len(clean) == 40
    (checkout / "README.md").write_text("the page")
    assert rows.commit() == clean
    (checkout / "workflow" / "code.py").write_text("1")
    assert rows.commit() == f"{clean} with edits"


def test_outside_of_a_repository_no_commit_is_known(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert rows.commit() == "unknown"


def test_the_processor_is_the_model_that_the_system_tells(tmp_path):
    cpuinfo = tmp_path / "cpuinfo"
    assert rows.processor(cpuinfo) == rows.platform.machine()
    cpuinfo.write_text(
        "processor\t: 0\nmodel\t\t: 167\nmodel name\t: A Fast One\n\nprocessor\t: 1\n"
    )
    assert rows.processor(cpuinfo) == "A Fast One"


@pytest.mark.parametrize(
    "machine_s, process_s, cores", [(3.0, 0.0, 1.5), (3.0, 2.0, 0.5), (0.0, 1.0, 0.0)]
)
def test_work_of_others_is_the_machines_without_that_of_the_process(
    machine_s, process_s, cores, monkeypatch
):
    """In two seconds; the last: a tick that the machine's count has not yet seen."""
    (clock, busy, process) = (100.0, 50.0, 7.0)
    monkeypatch.setattr(rows.time, "perf_counter", lambda: clock)
    monkeypatch.setattr(rows, "_busy_seconds", lambda: busy)
    monkeypatch.setattr(os, "times", lambda: (process, 0.0, 0.0, 0.0, clock))
    other_work = rows.OtherWork()
    clock, busy, process = clock + 2.0, busy + machine_s, process + process_s
    assert other_work.cores() == cores


def test_the_machines_seconds_are_read_from_the_system():
    before = rows._busy_seconds()
    sum(range(10**7))
    assert rows._busy_seconds() >= before > 0.0
