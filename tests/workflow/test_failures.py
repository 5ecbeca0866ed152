"""After a failure, a kill or the loss of records the next run makes what is missing or other."""

import os
import re
import shutil
import subprocess
import time
from functools import cache
from itertools import product

import pytest
from house import House

pytestmark = pytest.mark.xdist_group("finished")

# In the process of a script, given in the environment: the job dies as it starts, or as it has
# written its first file, or has no room for it, or waits for a file of the name `go`.
FAILING = """
import errno, os, signal, sys, time
rule, _, way = os.environ.get("FAILING", "").partition(":")
if way and any(word.endswith(f".{rule}.py") for word in sys.orig_argv):
    if way == "at its start":
        os.kill(os.getpid(), signal.SIGKILL)
    while way == "held" and not os.path.exists("go"):
        time.sleep(0.05)
    replace = os.replace
    def failing(*paths):
        if way == "for want of room":
            raise OSError(errno.ENOSPC, "No space left on device", str(paths[1]))
        replace(*paths)
        os.kill(os.getpid(), signal.SIGKILL)
    if way != "held":
        os.replace = failing
"""
AT_ITS_START, WRITTEN, NO_ROOM = "at its start", "once it has written", "for want of room"
SPLIT = "results/splits/simulated-tiny/session.parquet"
EDIT = ("tiny.yaml", "{epsilon: 0.03}", "{epsilon: 0.04}")
CHAIN = ["perturb", "simulated_dataset", "split"]
TEACHERS = {"train_autoencoder", "train_regressor"}
# By name: an edit, what is asked for, the rules that make it again, one after the other.
STORIES = {
    "perturbation": (
        EDIT,
        "results/metrics/simulated-tiny/session/small/physics-informed-mlp.csv",
        [*CHAIN, "train_autoencoder", "train_regressor", "train_predictor", "evaluate"],
    ),
    "skin": (
        ("config.yaml", "mean_N: 5.0", "mean_N: 5.5"),
        "results/datasets/simulated-tiny.parquet",
        ["mesh", "skin_effects", "perturb", "simulated_dataset"],
    ),
    "twin": (
        ("tiny.yaml", "{ratio: 2.0}", "{ratio: 3.0}"),
        "results/datasets/simulated-twin.parquet",
        ["twin", "import_recording", "check", "record_dataset"],
    ),
    "code": (
        (
            "workflow/eitskin/limit/ratios.py",
            "import pandas as pd\n",
            "import pandas as pd\n\nX = 1\n",
        ),
        "results/limit/simulated-tiny-continuous.ratios.csv",
        ["ratios"],
    ),
}
WAYS = AT_ITS_START, WRITTEN, NO_ROOM
FAILURES = [
    *product(["perturbation"], STORIES["perturbation"][2], WAYS),
    *product(["skin"], ["mesh", "skin_effects"], WAYS),
    *product(["twin"], STORIES["twin"][2], WAYS),
    *product(["code"], ["ratios"], (AT_ITS_START, NO_ROOM)),
]


def begun(house: House, target: str, failing: str = "") -> subprocess.Popen:
    """A run in the background."""
    site = house.folder.parent / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text(FAILING)
    path = f"{site}{os.pathsep}{house.environment['PYTHONPATH']}"
    return subprocess.Popen(
        house.command("--", target, cores=1),
        cwd=house.folder,
        env=house.environment | {"PYTHONPATH": path, "FAILING": failing},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def run(house: House, target: str, failing: str = "") -> tuple[int, set[str]]:
    """The exit code of a run, and the rules of the jobs that it meant to do."""
    process = begun(house, target, failing)
    said, _ = process.communicate()
    stats = re.findall(r"^(\w+) +\d+$", said, re.MULTILINE)
    return process.returncode, set(stats) - {"total", "all"}


@pytest.fixture
def house(finished, tmp_path):
    return finished.copy(tmp_path / "house")


@pytest.fixture(scope="module")
def whole(finished, tmp_path_factory):
    """The results of an uninterrupted run after an edit, by the edit and what is asked for."""

    @cache
    def results(edit: tuple, target: str, rules: tuple) -> dict[str, str]:
        house = finished.copy(tmp_path_factory.mktemp("whole") / "house")
        house.edit(*edit)
        assert run(house, target) == (0, set(rules))
        return house.digests()

    return results


def lost(house: House, *files: str) -> None:
    """What a cluster takes away of a group of jobs of which one has failed."""
    for file in files:
        (house.folder / file).unlink()


def older(house: House) -> None:
    for file in (house.folder / "results").rglob("*.parquet"):
        os.utime(file, (1e9, 1e9))


def forgetful(house: House) -> None:
    shutil.rmtree(house.folder / ".snakemake")


def run_twice(house: House, target: str, held: str) -> None:
    """A run to its end, the job of a rule being held; one more that is begun meanwhile is refused,
    and a plan is of no consequence."""
    first = begun(house, target, f"{held}:held")
    while not list((house.folder / ".snakemake" / "locks").glob("*.lock")):
        assert first.poll() is None
        time.sleep(0.01)
    assert run(house, target) == (1, set())
    house.jobs(target)
    (house.folder / "go").touch()
    first.communicate()
    assert first.returncode == 0


def test_failures_one_after_the_other_are_all_mended_by_the_next_run(house, whole):
    """Each run is asked for the same and makes what the one before has left."""
    house.edit(*EDIT)
    made = "results/simulated/tiny/3-crosstalk.parquet", "results/datasets/simulated-tiny.parquet"
    for failing, planned, mishap in (
        (f"perturb:{AT_ITS_START}", CHAIN, None),
        (f"perturb:{WRITTEN}", CHAIN, forgetful),
        (f"simulated_dataset:{AT_ITS_START}", CHAIN, None),
        (f"simulated_dataset:{WRITTEN}", CHAIN[1:], older),
        (f"split:{AT_ITS_START}", CHAIN[1:], None),
        (f"split:{WRITTEN}", CHAIN[2:], lambda house: lost(house, *made)),
        (f"split:{NO_ROOM}", CHAIN, None),
    ):
        assert run(house, SPLIT, failing) == (1, set(planned))
        if mishap is not None:
            mishap(house)
    run_twice(house, SPLIT, "split")
    assert run(house, SPLIT) == (0, set())
    assert house.digests() == whole(EDIT, SPLIT, (*CHAIN,))


@pytest.mark.rehearsal
@pytest.mark.parametrize(("story", "rule", "way"), FAILURES)
def test_a_run_goes_on_after_a_job_has_failed(house, whole, story, rule, way):
    edit, target, rules = STORIES[story]
    house.edit(*edit)
    assert run(house, target, f"{rule}:{way}") == (1, set(rules))
    code, planned = run(house, target)
    ahead = set(rules[rules.index(rule) :])
    assert code == 0 and ahead <= planned <= ahead | TEACHERS
    assert house.digests() == whole(edit, target, (*rules,))


@pytest.mark.rehearsal
def test_a_group_that_is_lost_is_made_again_with_what_reads_it(house):
    """Snakemake runs what reads a file that it makes again, though that was there; no more."""
    before = house.digests()
    rules = {"twin", "import_recording", "check", "record_dataset"}
    group = [file for file in before if file.startswith(("results/twin/", "results/recordings/"))]
    lost(house, *group, "results/datasets/simulated-twin.parquet")
    readers = {"split", "train_predictor", "evaluate", "diagnose", "diagnosis_report"}
    assert house.jobs() == rules | readers
    assert run(house, "results/datasets/simulated-twin.parquet") == (0, rules)
    assert house.digests() == before


@pytest.mark.rehearsal
def test_a_record_that_is_lost_makes_its_job_again_alone(house):
    before = house.digests()
    (house.folder / "results/provenance/jobs/split/simulated-tiny/session.json").unlink()
    assert house.jobs() == {"split"}
    assert run(house, SPLIT) == (0, {"split"})
    assert house.digests() == before and house.pending() == set()


def test_without_snakemake_s_records_an_edit_plans_what_it_does_with_them(house):
    house.edit(*EDIT)
    pending = house.pending()
    shutil.rmtree(house.folder / ".snakemake")
    assert house.pending() == pending and len(pending) > 20


@pytest.mark.parametrize("days", [-10_000, pytest.param(1, marks=pytest.mark.long)])
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
    shutil.copy2(twin, given)
    assert house.jobs(check, files=["more.yaml"]) == {"import_recording", "check"}


def test_a_missing_product_is_made_again_and_not_what_is_far_from_it(house):
    (house.folder / "results/simulated/tiny/1-channel-gain.parquet").unlink()
    assert house.jobs() == {"perturb"}
