"""What it costs to plan a workflow of many recordings, and what provenance costs a job."""

import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

from benchmark import rows
from eitskin import provenance
from eitskin.progress import patient

LIMIT_S = {1_000: 10.0, 10_000: 100.0}  # of a plan, by how many recordings there are
LIMIT_MS = 50.0  # of provenance, a job
JOBS_EACH = 2  # of a recording that is read and checked, no more
INPUT_BYTES = 1 << 20  # of the file that the timed job reads


def planned(runs: int) -> list[dict]:
    """Processor seconds of a dry run from nothing, Snakemake's start with it, of as many recordings
    as LIMIT_S says, once each; and the milliseconds of provenance a job: to plan it, all that
    Snakemake plans with it, and to record what a job has made of INPUT_BYTES that are new."""
    counts = patient([1, *LIMIT_S], "planned, recordings")
    seconds = {count: plan_s(count) for count in counts}
    job_s = (seconds[max(LIMIT_S)] - seconds[1]) / (JOBS_EACH * (max(LIMIT_S) - 1))
    job_ms = [1000.0 * (job_s + recording_s()) for _ in range(runs)]
    return [
        *(
            rows.row(f"plan, {count} recordings", "s", [seconds[count]], "limit", [limit_s])
            for count, limit_s in LIMIT_S.items()
        ),
        rows.row("provenance, a job", "ms", job_ms, "limit", [LIMIT_MS]),
    ]


def plan_s(count: int) -> float:
    """Processor seconds of a dry run, by a process of its own, that would read and check `count`
    recordings, in a folder where nothing was made or planned before."""
    with TemporaryDirectory() as folder:
        names = [f"skin-{number}" for number in range(count)]
        for name in names:
            Path(folder, f"{name}.parquet").write_bytes(b"PAR1" + name.encode())
        lines = [f"  {name}: {{path: {name}.parquet}}\n" for name in names]
        Path(folder, "many.yaml").write_text(f"recordings:\n{''.join(lines)}", encoding="utf-8")
        files = ["--snakefile", str(rows.ROOT / "Snakefile"), "--configfile", "many.yaml"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "snakemake", *files, "--cores", "1", "--dry-run", "--quiet"],
            cwd=folder,
            check=True,
            capture_output=True,
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def recording_s() -> float:
    """Processor seconds to plan and to record the provenance of a job of one new input, without
    what Snakemake does."""
    home = Path.cwd()
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            Path("input").write_bytes(os.urandom(INPUT_BYTES))
            Path("product").touch()
            start = time.process_time()
            code = "a digest"
            provenance.plan_code(code, {"module": "digest"})
            digests = {"input": provenance.digest_of_file("input")}
            text = provenance.text("a rule", {"seed": 1}, code, digests, ["product"])
            planned_path = provenance.planned_path("job")
            provenance.plan(planned_path, text, ["product"], stale=False)
            job = SimpleNamespace(
                log=["job.log"],
                input={"provenance": planned_path},
                params=SimpleNamespace(code=code, provenance=text),
            )
            with provenance.recorded(job):
                pass
            return time.process_time() - start
        finally:
            os.chdir(home)
