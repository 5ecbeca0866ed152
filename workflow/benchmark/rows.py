"""A row of a bench with the value of every run, and the conditions of the measurement."""

import os
import platform
import re
import statistics
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
MEASURED = ("workflow", "config.yaml")  # the paths of the repository that a bench runs


def row(
    name: str,
    unit: str,
    ours: Sequence[float],
    peer_name: str,
    peer: Sequence[float],
    statistic: Callable[[Sequence[float]], float] = statistics.median,
) -> dict:
    """One row of a bench: the statistic over the runs on each side, a limit being one value;
    ratio = ours / peer."""
    ours_value, peer_value = statistic(ours), statistic(peer)
    return {
        "name": name,
        "unit": unit,
        "ours": ours_value,
        "ours_runs": list(ours),
        "peer_name": peer_name,
        "peer": peer_value,
        "peer_runs": list(peer),
        "ratio": ours_value / peer_value,
        "runs": len(ours),
    }


def commit() -> str:
    """The checked-out commit; " with edits" where MEASURED differs, "unknown" without git."""
    try:
        head = _git("rev-parse", "HEAD")
        edits = _git("status", "--porcelain", "--untracked-files=no", "--", *MEASURED)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head} with edits" if edits else head


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def machine() -> dict:
    """The processor, the cores available to this process, the memory in GiB."""
    return {
        "processor": processor(Path("/proc/cpuinfo")),
        "cores": len(os.sched_getaffinity(0)),
        "memory_GiB": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30,
    }


def processor(cpuinfo: Path) -> str:
    """The processor's model in the file; the architecture where it has none."""
    text = cpuinfo.read_text(encoding="utf-8") if cpuinfo.exists() else ""
    model = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return model[1] if model else platform.machine()


def _busy_seconds() -> float:
    """Processor seconds of the whole machine since it started."""
    words = Path("/proc/stat").read_text(encoding="utf-8").split("\n")[0].split()
    user, nice, system, _, _, interrupts, soft, *_ = map(int, words[1:])
    return (user + nice + system + interrupts + soft) / os.sysconf("SC_CLK_TCK")


class OtherWork:
    """The number of cores that other work on the machine uses, from now on."""

    def __init__(self) -> None:
        self.start, self.seconds_before = time.perf_counter(), self._seconds()

    @staticmethod
    def _seconds() -> float:
        """Processor seconds of the machine without this process and its ended children."""
        return _busy_seconds() - sum(os.times()[:4])

    def cores(self) -> float:
        """The mean number of cores since the start, at least 0: the kernel counts in steps of
        10 ms, over a few milliseconds many cores in either direction."""
        seconds = time.perf_counter() - self.start
        return max((self._seconds() - self.seconds_before) / seconds, 0.0)
