"""A line of a bench, with every run's value; where and of what it was measured."""

import os
import platform
import re
import statistics
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
MEASURED = ("workflow", "config.yaml")  # what a bench runs, of the repository


def row(
    name: str,
    unit: str,
    ours: Sequence[float],
    peer_name: str,
    peer: Sequence[float],
    of: Callable[[Sequence[float]], float] = statistics.median,
) -> dict:
    """One line of a bench: `of` the values of the runs on each side, a limit being one value;
    ratio = ours / peer."""
    middle, beside = of(ours), of(peer)
    return {
        "name": name,
        "unit": unit,
        "ours": middle,
        "ours_runs": list(ours),
        "peer_name": peer_name,
        "peer": beside,
        "peer_runs": list(peer),
        "ratio": middle / beside,
        "runs": len(ours),
    }


def commit() -> str:
    """The commit that is checked out; " with edits" where what is measured differs from it,
    "unknown" where git does not tell."""
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
    """Processor, cores that this process may use, memory in GiB."""
    return {
        "processor": processor(Path("/proc/cpuinfo")),
        "cores": len(os.sched_getaffinity(0)),
        "memory_GiB": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30,
    }


def processor(told: Path) -> str:
    """The model that the file tells; the architecture where it tells none."""
    text = told.read_text(encoding="utf-8") if told.exists() else ""
    model = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return model[1] if model else platform.machine()


class Others:
    """How many cores other work on the machine takes, from now on."""

    def __init__(self) -> None:
        self.began, self.before = time.perf_counter(), self._seconds()

    @staticmethod
    def _seconds() -> float:
        """Processor seconds of the whole machine, without this process and its ended children."""
        words = Path("/proc/stat").read_text(encoding="utf-8").split("\n")[0].split()
        user, nice, system, _, _, interrupts, soft, *_ = map(int, words[1:])
        busy = (user + nice + system + interrupts + soft) / os.sysconf("SC_CLK_TCK")
        return busy - sum(os.times()[:4])

    def cores(self) -> float:
        """Their mean until now."""
        return (self._seconds() - self.before) / (time.perf_counter() - self.began)
