"""What diagnoses of 500 frames take, one at a time and two at once."""

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
DIAGNOSIS_S, WORST_S, DIAGNOSIS_MIB = 30.0, 120.0, 4096.0


def diagnose(kind: str, seed: int, frames: int, cores: int) -> tuple[float, float]:
    """Draw a recording and diagnose it as `eitskin diagnose` does on so many cores, report and all.

    Returns seconds and the process's peak memory in MiB, of the diagnosis: call it in a fresh
    process. Raises RuntimeError where the diagnosis fails.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.parquet"
        os.environ["OMP_NUM_THREADS"] = str(cores)
        case = cases.draw(kind, seed, frames)
        recording.write(case.recorded, path)
        return diagnosis(path)


def diagnosis(path: Path, *options: str) -> tuple[float, float]:
    """Seconds of `eitskin diagnose` of a recording, and the process's peak memory in MiB; its
    folder `out` is made beside the file. Raises RuntimeError where it fails."""
    start = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        code = cli.main(["diagnose", str(path), "--out", str(path.with_name("out")), *options])
    seconds = time.perf_counter() - start
    if code:
        raise RuntimeError(f"the diagnosis of {path.name} ended with code {code}")
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def diagnosed(runs: int) -> list[dict]:
    """Seconds and peak memory of diagnoses of 500 frames, beside what they may take.

    `runs` recordings of 16 electrodes, of the kinds DRAWN in turn, drawn by `witness`; each in a
    fresh process, first one after the other on two cores, then two at a time on one each.
    """
    found = []
    for at_once, words in ((1, ""), (2, ", two at once")):
        cores = 2 // at_once
        drawn = [(DRAWN[i % len(DRAWN)], 1 + i // len(DRAWN), FRAMES, cores) for i in range(runs)]
        pool = ProcessPoolExecutor(at_once, get_context("spawn"), max_tasks_per_child=1)
        with pool:
            done = pool.map(diagnose, *zip(*drawn, strict=True))
            told = [next(done) for _ in patient(range(runs), f"diagnosed{words}, runs")]
        seconds, peaks = zip(*told, strict=True)
        for name, unit, values, limit, of in (
            ("median", "s", seconds, DIAGNOSIS_S, statistics.median),
            ("worst", "s", seconds, WORST_S, max),
            ("memory, most", "MiB", peaks, DIAGNOSIS_MIB, max),
        ):
            title = f"limit for {FRAMES} frames"
            found.append(rows.row(f"diagnosed{words}, {name}", unit, values, title, [limit], of))
    return found
