"""What tests cost in processor seconds, and the shares of the long tests that commits take in turn.

`tests/durations.csv` has a line for each test file, and one for each test function that takes at
least half a second, its parameters together. A column holds the seconds of one run: `test` of
`make test`, `long` of `make test-long`. `make durations` renews both.
"""

import csv
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping
from os import times  # by name: tests replace `os.times`
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests" / "durations.csv"
PAGE = ROOT / "CONTRIBUTING.md"
RUNS = ("test", "long")
SLOW_S = 0.5  # a shorter test function has no line of its own
SHORT_S = 0.1  # about what it costs
SLOWEST = 8  # lines of a run in CONTRIBUTING.md
SHARDS = 3  # a prime: commits pushed in pairs or fours still come by all
BEGIN, END = "<!-- slowest tests -->", "<!-- end of the slowest tests -->"

Durations = dict[str, dict[str, float]]  # seconds by run, by file or test function


forked_seconds: list[float] = []  # of processes that a fork server forked: no children of ours


def processor_seconds() -> float:
    """Processor time of this process and of those that it has waited for, s."""
    return sum(times()[:4]) + sum(forked_seconds)


def function_of(nodeid: str) -> str:
    """A test's file and function, without its parameters and the group that xdist appends."""
    return nodeid.partition("[")[0].partition("@")[0]


def file_of(nodeid: str) -> str:
    return nodeid.partition("::")[0]


def read(path: Path = TABLE) -> Durations:
    """Seconds by run, by file or test function."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as lines:
        return {
            row["name"]: {run: float(row[run]) for run in RUNS if row[run]}
            for row in csv.DictReader(lines)
        }


def rounded(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 10.0 else f"{seconds:.1f}"


def write(durations: Durations, path: Path = TABLE) -> None:
    """Rounded and sorted, so that a renewal changes few lines."""
    with path.open("w", newline="", encoding="utf-8") as lines:
        table = csv.writer(lines, lineterminator="\n")
        table.writerow(("name", *RUNS))
        for test in sorted(durations):
            seconds = durations[test]
            cells = (rounded(seconds[run]) if run in seconds else "" for run in RUNS)
            table.writerow((test, *cells))


def renewed(durations: Durations, run: str, seconds: Mapping[str, float]) -> Durations:
    """The table with the lines of the files that a run tested replaced in that run's column;
    `seconds` by node id. Files that are no more are left out."""
    measured: dict[str, float] = {}
    for nodeid, test_s in seconds.items():
        for key in (file_of(nodeid), function_of(nodeid)):
            measured[key] = measured.get(key, 0.0) + test_s
    measured = {key: s for key, s in measured.items() if "::" not in key or s >= SLOW_S}
    tested_files = {file_of(nodeid) for nodeid in seconds}
    table: Durations = {}
    for test, by_run in durations.items():
        if (ROOT / file_of(test)).exists():
            is_stale = file_of(test) in tested_files
            table[test] = {r: s for r, s in by_run.items() if r != run or not is_stale}
    for test, test_s in measured.items():
        table.setdefault(test, {})[run] = test_s
    return {test: by_run for test, by_run in table.items() if by_run}


def slowest(durations: Durations) -> str:
    """The slowest test functions of both runs as a table in Markdown."""
    lines = ["| run | test | processor seconds |", "|---|---|---|"]
    for run in RUNS:
        functions = [(s[run], test) for test, s in durations.items() if "::" in test and run in s]
        for test_s, test in sorted(functions, key=lambda line: (-line[0], line[1]))[:SLOWEST]:
            name = test.removeprefix("tests/").removeprefix("unit/")
            command = {"test": "make test", "long": "make test-long"}[run]
            lines.append(f"| `{command}` | `{name}` | {rounded(test_s)} |")
    return "\n".join(lines)


def page_with_slowest(page: str, durations: Durations) -> str:
    """CONTRIBUTING.md with its table of the slowest tests as the durations have it."""
    head, _, tail = page.partition(BEGIN)
    return f"{head}{BEGIN}\n\n{slowest(durations)}\n\n{END}{tail.partition(END)[2]}"


def renew(run: str, seconds: Mapping[str, float]) -> None:
    """Write what a run measured into the table, and its slowest tests into CONTRIBUTING.md."""
    durations = renewed(read(), run, seconds)
    write(durations)
    text = page_with_slowest(PAGE.read_text(encoding="utf-8"), read())
    PAGE.write_text(text, encoding="utf-8")


def commit_shard() -> int | None:
    """The shard of the commit that is checked out, 1 to SHARDS: commits take them in turn. None
    without a history to count: all tests are run."""

    def git(*arguments: str) -> str:
        command = ["git", "-C", str(ROOT), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        if git("rev-parse", "--is-shallow-repository") == "true":
            return int(git("rev-parse", "HEAD"), 16) % SHARDS + 1
        return int(git("rev-list", "--count", "HEAD")) % SHARDS + 1
    except (OSError, subprocess.CalledProcessError):
        return None


def seconds_of(nodeids: Iterable[str], run: str, durations: Durations) -> dict[str, float]:
    """What each of a run's tests costs by the table, s: an equal part of its function's line; one
    without a line is short."""
    nodeids = list(nodeids)
    tests = Counter(map(function_of, nodeids))
    return {
        nodeid: durations.get(function, {}).get(run, SHORT_S) / tests[function]
        for nodeid, function in zip(nodeids, map(function_of, nodeids), strict=True)
    }


def shards(seconds: Mapping[str, float]) -> dict[str, int]:
    """The shard of each group of tests, 1 to SHARDS: the dearest first, each to the shard that has
    least to do."""
    load_s = [0.0] * SHARDS
    numbers = {}
    for group in sorted(seconds, key=lambda name: (-seconds[name], name)):
        shard = load_s.index(min(load_s))
        load_s[shard] += seconds[group]
        numbers[group] = shard + 1
    return numbers
