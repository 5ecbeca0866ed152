"""After a failure, a kill or the loss of records the next run makes what is missing or other."""

import os
import re
import shutil
import subprocess
import time
from itertools import product

import pytest
from house import House

pytestmark = pytest.mark.xdist_group("finished")

# In the process of a script, given in the environment: the job dies as it starts, or as it has
# written its first file, or has no room for it.
FAILING = """
import errno, os, signal, sys
rule, _, way = os.environ.get("FAILING", "").partition(":")
if way and any(word.endswith(f".{rule}.py") for word in sys.orig_argv):
    if way == "at its start":
        os.kill(os.getpid(), signal.SIGKILL)
    replace = os.replace
    def failing(*paths):
        if way == "for want of room":
            raise OSError(errno.ENOSPC, "No space left on device", str(paths[1]))
        replace(*paths)
        os.kill(os.getpid(), signal.SIGKILL)
    os.replace = failing
"""
WAYS = ("at its start", "once it has written", "for want of room")
SPLIT = "results/splits/simulated-tiny/session.parquet"
METRICS = "results/metrics/simulated-tiny/session/small/physics-informed-mlp.csv"
EDIT = ("tiny.yaml", "{epsilon: 0.03}", "{epsilon: 0.04}")
CHAIN = ["perturb", "simulated_dataset", "split"]
LEARNED = [*CHAIN, "train_autoencoder", "train_regressor", "train_predictor", "evaluate"]


def run(house: House, target: str, failing: str = "") -> tuple[int, set[str]]:
    """The exit code of a run, and the rules of the jobs that it meant to do."""
    site = house.folder.parent / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(FAILING)
    path = f"{site}{os.pathsep}{house.environment['PYTHONPATH']}"
    done = subprocess.run(
        house.command("--", target, cores=1),
        cwd=house.folder,
        env=house.environment | {"PYTHONPATH": path, "FAILING": failing},
        capture_output=True,
        text=True,
    )
    stats = re.findall(r"^(\w+) +\d+$", done.stdout + done.stderr, re.MULTILINE)
    return done.returncode, set(stats) - {"total", "all"}


@pytest.fixture
def house(finished, tmp_path):
    return finished.copy(tmp_path / "house")


@pytest.fixture(scope="module")
def edited(finished, tmp_path_factory) -> dict[str, str]:
    """The results of an uninterrupted run after the edit, by target."""
    digests = {}
    house = finished.copy(tmp_path_factory.mktemp("edited") / "house")
    house.edit(*EDIT)
    assert run(house, SPLIT) == (0, set(CHAIN))
    digests[SPLIT] = house.digests()
    return digests


def test_what_fails_after_an_edit_is_made_by_the_next_run_with_all_that_follows(house, edited):
    house.edit(*EDIT)
    left = CHAIN
    for place, rule in enumerate(CHAIN):
        for way in WAYS[:2] if rule != "split" else WAYS:
            assert run(house, SPLIT, f"{rule}:{way}") == (1, set(left))
            left = CHAIN[place:]
    assert run(house, SPLIT) == (0, {"split"})
    assert run(house, SPLIT) == (0, set())
    assert house.digests() == edited[SPLIT]


@pytest.mark.rehearsal
@pytest.mark.parametrize(("rule", "way"), [*product(LEARNED, WAYS)])
def test_a_run_of_all_goes_on_after_a_job_has_failed(finished, house, rule, way):
    whole = finished.copy(house.folder.parent / "whole")
    for each in (house, whole):
        each.edit(*EDIT)
    assert run(whole, METRICS) == (0, set(LEARNED))
    code, planned = run(house, METRICS, f"{rule}:{way}")
    assert code == 1 and planned == set(LEARNED)
    code, planned = run(house, METRICS)
    ahead = set(LEARNED[LEARNED.index(rule) :])
    assert code == 0 and ahead <= planned <= ahead | {"train_autoencoder", "train_regressor"}
    assert house.digests() == whole.digests()


def test_without_snakemake_s_records_an_edit_plans_what_it_does_with_them(house):
    house.edit(*EDIT)
    pending = house.pending()
    shutil.rmtree(house.folder / ".snakemake")
    assert house.pending() == pending and len(pending) > 20


def test_an_edit_and_its_contrary_plan_nothing(house):
    file, old, new = EDIT
    house.edit(file, old, new)
    assert "results/datasets/simulated-tiny.parquet" in house.pending()
    house.edit(file, new, old)
    assert house.pending() == set()


@pytest.mark.parametrize("days", [-10_000, 1])
def test_times_of_files_are_no_reason(house, days):
    late = time.time() + days * 86_400
    for file in (house.folder / "results").rglob("*parquet"):
        os.utime(file, (late, late))
    assert house.pending() == set()
    house.edit("tiny.yaml", "noise: 0.01", "noise: 0.02")
    assert "results/simulated/tiny/3-crosstalk.parquet" not in house.pending()
    assert run(house, "results/datasets/simulated-tiny.parquet") == (0, {"simulated_dataset"})


def test_a_recording_replaced_by_an_older_file_is_imported_again(house):
    given, older = house.folder / "given.parquet", house.folder / "older.parquet"
    twin = house.folder / "results" / "recordings" / "simulated-twin.parquet"
    shutil.copy(twin, given)
    more = house.folder / "more.yaml"
    more.write_text("recordings: {given: {path: given.parquet}}\n")
    check = "results/recordings/given.check.txt"
    done = house.snakemake("more.yaml", "--", check)
    assert done.returncode == 0, done.stderr
    assert house.jobs(check, files=["more.yaml"]) == set()
    os.utime(given, (1e9, 1e9))
    assert house.jobs(check, files=["more.yaml"]) == set()
    older.write_bytes(given.read_bytes()[:-1])
    os.utime(older, (1e9, 1e9))
    shutil.copy2(older, given)
    assert house.jobs(check, files=["more.yaml"]) == {"import_recording", "check"}
    for _ in range(2):
        refused = house.snakemake("more.yaml", "--", check)
        assert refused.returncode == 1 and "given.parquet" in refused.stdout + refused.stderr


def test_a_missing_product_is_made_again_and_not_what_is_far_from_it(house):
    (house.folder / "results/simulated/tiny/1-channel-gain.parquet").unlink()
    assert house.jobs() == {"perturb"}
