"""The workflow on a Slurm of two nodes gives the bytes of a local run, whatever happens meanwhile:
a node is lost, a source file is edited."""

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest
from slurm import Cluster, loopback, obstacle

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(obstacle() is not None, reason=f"no Slurm: {obstacle()}"),
]

SLURM = (
    "--workflow-profile=profiles/slurm",
    "--slurm-init-seconds-before-status-checks=2",
    "--group-components",
    *("data=3", "training=6", "evaluation=6"),
)
# What the second test makes anew, and what it edits while that goes on.
LEARNED = [f"results/{kind}/simulated-twin" for kind in ("models", "predictions", "metrics")]
MADE_OF_THEM = "results/tables"
EDIT = (
    "workflow/eitskin/learn/metrics.py",
    "np.abs(truth - predicted).mean()",
    "2.0 * np.abs(truth - predicted).mean()",
)


@pytest.fixture
def cluster(tmp_path) -> Iterator[Cluster]:
    with loopback(tmp_path / "slurm") as running:
        yield running


@contextmanager
def begun(house, cluster) -> Iterator[subprocess.Popen]:
    """A run on the cluster, in the background; what it says goes to a file beside the results."""
    with (house.folder / "run.log").open("a") as log:
        process = subprocess.Popen(
            house.command(*SLURM, cores=4),
            cwd=house.folder,
            env=house.environment | cluster.environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            yield process
        finally:
            with suppress(subprocess.TimeoutExpired):
                process.terminate()  # it takes its jobs back
                process.wait(30)
            process.kill()


def wait_for(seen: Callable[[], str | None], process: subprocess.Popen) -> str:
    """What is seen at last, while a run goes on."""
    deadline = time.monotonic() + 600
    while (found := seen()) is None:
        assert process.poll() is None, "the run ended before"
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return found


def finish(house, cluster, process: subprocess.Popen) -> int:
    """Wait for the end; where the run failed begin it again, once. How often it was begun."""
    if process.wait(1200) == 0:
        return 1
    with begun(house, cluster) as again:
        assert again.wait(1200) == 0, (house.folder / "run.log").read_text()[-4000:]
    return 2


@pytest.fixture
def say(capsys):
    """Print to whoever waits."""

    def aloud(text: str) -> None:
        with capsys.disabled():
            print(f"\n{text}", flush=True)

    return aloud


def test_a_lost_node_changes_no_byte(fresh, finished, cluster, tmp_path, say):
    house = fresh.copy(tmp_path / "house")
    start = time.monotonic()
    with begun(house, cluster) as process:
        node = wait_for(cluster.working, process)
        lost = cluster.fail(node)
        say(f"{node} lost after {time.monotonic() - start:.0f} s with the jobs {lost}")
        runs = finish(house, cluster, process)
    say(f"{len(cluster.jobs())} Slurm jobs in {time.monotonic() - start:.0f} s, begun {runs} times")
    assert lost
    assert cluster.node_states()[node].startswith("down")
    assert house.results() == finished.results()
    assert house.pending() == set()


def test_what_an_edit_meanwhile_makes_stale_is_made_again(finished, cluster, tmp_path, say):
    """Jobs read the workflow anew. What they find stale is not theirs to make: it would be made by
    several at once."""
    house, local = (finished.copy(tmp_path / name) for name in ("house", "local"))
    for folder in (*LEARNED, MADE_OF_THEM):
        shutil.rmtree(house.folder / folder)
    others = times(house)
    start = time.monotonic()
    with begun(house, cluster) as process:
        wait_for(cluster.working, process)
        house.edit(*EDIT)
        say(f"a source file edited after {time.monotonic() - start:.0f} s")
        assert process.wait(1200) == 0, (house.folder / "run.log").read_text()[-4000:]
    after = times(house)
    assert {file for file in others if others[file] != after[file]} == set()
    stale = house.pending()
    assert {file for file in stale if file.endswith("tiny/session/small/mlp.csv")}
    with begun(house, cluster) as process:
        assert process.wait(1200) == 0, (house.folder / "run.log").read_text()[-4000:]
    say(f"{len(cluster.jobs())} Slurm jobs in {time.monotonic() - start:.0f} s, begun 2 times")
    local.edit(*EDIT)
    run = local.snakemake()
    assert run.returncode == 0, run.stdout + run.stderr
    assert house.results() == local.results() != finished.results()
    assert house.pending() == set()


def times(house) -> dict[str, int]:
    """When each result was written, but for tables, which are made of them all."""
    files = [file for file in (house.folder / "results").rglob("*") if file.is_file()]
    names = {str(file.relative_to(house.folder)): file.stat().st_mtime_ns for file in files}
    return {name: at for name, at in names.items() if not name.startswith(MADE_OF_THEM)}
