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
PARTS = ("workflow", "envs", "profiles")  # folders of the repository that the workflow needs


def sweep(slots: int) -> tuple[float, float]:
    """Diagnoses in an hour by the clock, and processor seconds of a diagnosis including
    Snakemake's, for the first BATCHES of a block. Raises RuntimeError where the run fails."""
    files = [
        f"results/calibration/{BLOCK}/batches/{SIZE}-{number}.csv" for number in range(BATCHES)
    ]
    with TemporaryDirectory() as folder:
        for name in PARTS:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(rows.ROOT / name, Path(folder) / name, ignore=ignored)
        for name in ("Snakefile", "config.yaml"):
            shutil.copy(rows.ROOT / name, folder)
        run = [sys.executable, "-m", "snakemake", "--cores", str(slots), "--quiet", "all"]
        environment = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(folder) / "workflow")}
        start, busy_before = time.perf_counter(), _children()
        process = subprocess.run(
            [*run, "--", *files],
            cwd=folder,
            env=os.environ | environment,
            capture_output=True,
            text=True,
        )
        seconds, busy = time.perf_counter() - start, _children() - busy_before
        if process.returncode:
            raise RuntimeError(f"the sweep on {slots} slots failed: {process.stderr[-2000:]}")
        count = sum(len(pd.read_csv(Path(folder) / file)) for file in files)
    return 3600.0 * count / seconds, busy / count


def _children() -> float:
    """Processor seconds of ended children."""
    times = os.times()
    return times.children_user + times.children_system


def swept(runs: int) -> list[dict]:
    """Diagnoses in an hour on so many slots, beside as many times those on one; processor seconds
    of a diagnosis, beside those on one slot."""
    measurements: dict[int, list[tuple[float, float]]] = {slots: [] for slots in SLOTS}
    for run in range(1, runs + 1):
        for slots in patient(SLOTS, f"swept, run {run} of {runs}"):
            measurements[slots].append(sweep(slots))
    table_rows = []
    for slots in SLOTS:
        rates, busy = zip(*measurements[slots], strict=True)
        first_rates, first_busy = zip(*measurements[SLOTS[0]], strict=True)
        name = f"sweep, {slots} slot{'s' if slots > 1 else ''}"
        scaled_rates = [slots * rate for rate in first_rates]
        table_rows.append(
            rows.row(name, "diagnoses/h", rates, f"{slots} times one slot", scaled_rates)
        )
        table_rows.append(
            rows.row(f"{name}, a diagnosis", "processor s", busy, "one slot", first_busy)
        )
    return table_rows
