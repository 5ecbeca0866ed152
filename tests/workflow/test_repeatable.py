"""The same configuration gives the same bytes: again, on one core or two, and after a kill."""

import os
import signal
import subprocess
import time

import pytest

pytestmark = pytest.mark.xdist_group("finished")

LEARNED = "results/metrics/simulated-tiny/session/small/physics-informed-mlp.csv"
DIAGNOSED = "results/diagnosis/simulated-twin/diagnosis.json"
LIMIT = "results/limit/simulated-tiny-continuous.csv"


def unlocked(house):
    """Take away the lock that a killed run leaves, as the Makefile does."""
    assert house.snakemake("--unlock").returncode == 0


def test_every_result_is_there(finished):
    files = finished.digests()
    for file in (
        "results/simulated/clean.parquet",
        "results/datasets/simulated-tiny.parquet",
        "results/models/simulated-tiny/session/small/physics-informed-mlp/2.pt",
        "results/recordings/simulated-twin.check.txt",
        "results/tables/table_1.csv",
        "results/tables/table_1.md",
    ):
        assert file in files
    assert list((finished.folder / "results").rglob("*.part")) == []


def killed(house, seen, *arguments, cores):
    """Begin a run and kill it, its jobs with it, soon after the file or folder `seen` is there."""
    process = subprocess.Popen(
        house.command(*arguments, cores=cores),
        cwd=house.folder,
        env=house.environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 300
    while not (house.folder / seen).exists():
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    unlocked(house)


@pytest.mark.long
def test_on_one_core_and_killed_twice_it_gives_the_same_bytes(fresh, finished, tmp_path):
    house = fresh.copy(tmp_path / "house")
    for seen in ("results/simulated/tiny", "results/models"):
        killed(house, seen, "--", LEARNED, cores=1)
        assert not (house.folder / LEARNED).exists()
    run = house.snakemake("--", LEARNED, DIAGNOSED, LIMIT, cores=1)
    assert run.returncode == 0, run.stdout + run.stderr
    assert house.digests().keys() >= {LEARNED, DIAGNOSED, LIMIT}
    assert house.digests().items() <= finished.digests().items()
