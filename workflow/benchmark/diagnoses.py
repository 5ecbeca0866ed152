"""Time and memory of diagnoses of 500 frames, one at a time and two at once."""

import contextlib
import io
import os
import resource
import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmark import rows
from eitskin import cli
from eitskin.data import recording
from eitskin.progress import patient
from witness import cases

FRAMES = 500
DRAWN = (
    "null+rig",
    "single:contact-impedance+rig",
    "pair",
    "single:conductivity-drift+rig",
    "outside:gain-range+rig",
)
DIAGNOSIS_S, WORST_S, DIAGNOSIS_MIB = 30.0, 120.0, 4096.0  # limits: half a minute usually, 4 GiB


def diagnose(kind: str, seed: int, frames: int, cores: int) -> tuple[float, float]:
    """Draw a recording and diagnose it as by `eitskin diagnose` on so many cores, with its report.

    Returns the seconds of the diagnosis and the process's peak memory in MiB; to be called in a
    fresh process. Raises RuntimeError where the diagnosis fails.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.parquet"
        os.environ["OMP_NUM_THREADS"] = str(cores)
        case = cases.draw(kind, seed, frames)
        recording.write(case.recorded, path)
        return diagnosis(path)


def diagnosis(path: Path, *options: str) -> tuple[float, float]:
    """Seconds of `eitskin diagnose` of a recording, and the process's peak memory in MiB; the
    folder `out` is written beside the file. Raises RuntimeError where it fails."""
    start = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = cli.main(["diagnose", str(path), "--out", str(path.with_name("out")), *options])
    seconds = time.perf_counter() - start
    if code:
        raise RuntimeError(f"the diagnosis of {path.name} ended with code {code}")
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def diagnosed(runs: int) -> list[dict]:
    """Seconds and peak memory of diagnoses of 500 frames, beside limits.

    `runs` recordings of 16 electrodes, of the kinds DRAWN in turn, drawn by `witness`; each in a
    fresh process, first one after another on two cores, then two at a time on one core each.
    """
    table_rows = []
    for parallel, words in ((1, ""), (2, ", two at once")):
        cores = 2 // parallel
        jobs = [(DRAWN[i % len(DRAWN)], 1 + i // len(DRAWN), FRAMES, cores) for i in range(runs)]
        pool = ProcessPoolExecutor(parallel, get_context("spawn"), max_tasks_per_child=1)
        with pool:
            results_in_order = pool.map(diagnose, *zip(*jobs, strict=True))
            measurements = [
                next(results_in_order) for _ in patient(range(runs), f"diagnosed{words}, runs")
            ]
        seconds, peaks = zip(*measurements, strict=True)
        for name, unit, values, limit, statistic in (
            ("median", "s", seconds, DIAGNOSIS_S, statistics.median),
            ("worst", "s", seconds, WORST_S, max),
            ("memory, most", "MiB", peaks, DIAGNOSIS_MIB, max),
        ):
            title = f"limit for {FRAMES} frames"
            table_rows.append(
                rows.row(f"diagnosed{words}, {name}", unit, values, title, [limit], statistic)
            )
    return table_rows
