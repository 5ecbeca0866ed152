"""A sweep of diagnoses by the workflow, on one, two and four slots."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from benchmark import rows
from eitskin.progress import patient

BLOCK, SIZE = "ordinary-report", "full"
BATCHES = 4
SLOTS = (1, 2, 4)
PARTS = ("workflow", "envs", "profiles")  # folders of the repository that the workflow is


def sweep(slots: int) -> tuple[float, float]:
    """Diagnoses an hour by the clock and processor seconds of a diagnosis, Snakemake's own among
    them, of the first BATCHES of a block. Raises RuntimeError where the run fails."""
    made = [f"results/calibration/{BLOCK}/batches/{SIZE}-{number}.csv" for number in range(BATCHES)]
    with TemporaryDirectory() as folder:
        for name in PARTS:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(rows.ROOT / name, Path(folder) / name, ignore=ignored)
        for name in ("Snakefile", "config.yaml"):
            shutil.copy(rows.ROOT / name, folder)
        run = [sys.executable, "-m", "snakemake", "--cores", str(slots), "--quiet", "all"]
        one = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(folder) / "workflow")}
        start, before = time.perf_counter(), _children()
        done = subprocess.run(
            [*run, "--", *made],
            cwd=folder,
            env=os.environ | one,
            capture_output=True,
            text=True,
        )
        seconds, busy = time.perf_counter() - start, _children() - before
        if done.returncode:
            raise RuntimeError(f"the sweep on {slots} slots failed: {done.stderr[-2000:]}")
        count = sum(len(pd.read_csv(Path(folder) / file)) for file in made)
    return 3600.0 * count / seconds, busy / count


def _children() -> float:
    """Processor seconds of ended children."""
    times = os.times()
    return times.children_user + times.children_system


def swept(runs: int) -> list[dict]:
    """Diagnoses an hour on so many slots, beside as many times what one does; processor seconds of
    a diagnosis, beside those on one slot."""
    found: dict[int, list[tuple[float, float]]] = {slots: [] for slots in SLOTS}
    for run in range(1, runs + 1):
        for slots in patient(SLOTS, f"swept, run {run} of {runs}"):
            found[slots].append(sweep(slots))
    told = []
    for slots in SLOTS:
        rates, busy = zip(*found[slots], strict=True)
        first_rates, first_busy = zip(*found[SLOTS[0]], strict=True)
        name = f"sweep, {slots} slot{'s' if slots > 1 else ''}"
        wanted = [slots * one for one in first_rates]
        told.append(rows.row(name, "diagnoses/h", rates, f"{slots} times one slot", wanted))
        told.append(rows.row(f"{name}, a diagnosis", "processor s", busy, "one slot", first_busy))
    return told
