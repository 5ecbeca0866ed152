"""`python -m benchmark.checks FOLDER...`: what `eitskin check` says of every file in folders, with
its time and memory, as a Markdown table."""

import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from eitskin.cli import UNUSABLE
from eitskin.errors import printable

BESIDE = (".yaml", ".md", ".py", ".sh", "")  # endings of descriptions, pages and code
# A process that is begun by a large one counts that one's memory in its rusage; the peak of its own
# pages stands in /proc alone, until it ends.
CHECK = """
import sys
from pathlib import Path
from eitskin.cli import main
try:
    code = main(["check", *sys.argv[1:]])
finally:
    sys.stdout.flush()
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    print(status.partition("VmHWM:")[2].split()[0], file=sys.stderr, flush=True)
sys.exit(code)
"""
VERDICTS = {0: "usable", UNUSABLE: "not usable", 1: "refused"}
MAX_SHOWN = 120  # characters of a sentence


def rows(folders: Iterable[Path]) -> Iterator[tuple[str, float, float, str]]:
    """Of every file in the folders, by its path: seconds, GiB at most, and the verdict, with the
    first sentence against it."""
    for folder in folders:
        for file in sorted(folder.rglob("*")):
            if file.is_file() and file.suffix not in BESIDE and "README" not in file.name:
                yield (str(file.relative_to(folder)), *_checked(file))


def _checked(file: Path) -> tuple[float, float, str]:
    start = time.perf_counter()
    command = [sys.executable, "-c", CHECK, str(file)]
    ended = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    seconds, code = time.perf_counter() - start, ended.returncode
    peaks = [line for line in ended.stdout.splitlines() if line.isdecimal()]
    lines = [line for line in ended.stdout.splitlines() if not line.isdecimal()]
    is_traced = any(line.startswith("Traceback") for line in lines)
    verdict = "traceback" if is_traced else VERDICTS.get(code, f"ended with {code}")
    reasons = {1: lines[-1:], UNUSABLE: _against(lines)}.get(code, [])
    sentence = "".join(f": {reason.removeprefix(str(file)).strip(': ')}" for reason in reasons)
    shown = sentence if len(sentence) <= MAX_SHOWN else f"{sentence[:MAX_SHOWN]}…"
    return (
        seconds,
        float(peaks[-1]) / 2**20 if peaks else float("nan"),
        printable(verdict + shown).replace("|", "\\|"),
    )


def _against(lines: list[str]) -> list[str]:
    """The first sentence of a check's errors."""
    titles = [k for k, line in enumerate(lines) if line.startswith("What makes it unusable")]
    return lines[titles[0] + 1 : titles[0] + 2] if titles else lines[-1:]


def main(arguments: list[str]) -> int:
    """Print the table; returns the exit code, 2 for wrong usage."""
    folders = [Path(argument) for argument in arguments]
    if not folders or not all(folder.is_dir() for folder in folders):
        print("usage: python -m benchmark.checks FOLDER...", file=sys.stderr)
        return 2
    print("| file | s | GiB | verdict |\n|---|---|---|---|")
    for name, seconds, memory_GiB, verdict in rows(folders):
        print(f"| {name} | {seconds:.1f} | {memory_GiB:.2f} | {verdict} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
