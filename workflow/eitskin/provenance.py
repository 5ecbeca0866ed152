"""What made every product of the workflow, written down: its provenance, a small file a job.

A provenance is a text: the rule, its parameters, the fingerprint of its code, and each input with
the digest of its own provenance or, where no rule makes it, of its bytes. So it is other whenever
anything upstream is. RECORDS has those of the products that are there, PLANNED those that products
made now would have. No time of a file decides whether they are the same, and nothing that
Snakemake remembers.
"""

import contextlib
import hashlib
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from eitskin.atomic import atomic_path
from eitskin.errors import reported

RECORDS = "results/provenance"
PLANNED = ".snakemake/provenance"
# Folders within both: of jobs, and of code, the digests of all modules that a fingerprint is of.
JOBS, CODE = "jobs", "code"
FILES = f"{PLANNED}/files"  # digests of files as they were read last
PARSED = f"{PLANNED}/parsed.json"  # of modules, for the next process: `fingerprint.keep`
PAST = 1.0  # s since 1970: the time of a planned provenance once it is recorded
NO_FILE = "none"  # digest of an input that is not there and that no rule makes


def text(
    rule: str,
    parameters: Mapping[str, Any],
    code: str,
    inputs: Mapping[str, str],
    products: Iterable[str],
) -> str:
    """A provenance, equal for equal content; inputs: digests by path."""
    content = {
        "rule": rule,
        "parameters": dict(parameters),
        "code": code,
        "inputs": dict(inputs),
        "products": list(products),
    }
    lines = (",\n", ": ")  # without `indent`, with which Python's encoder is not the fast one
    return (
        json.dumps(content, separators=lines, sort_keys=True, ensure_ascii=False, default=str)
        + "\n"
    )


def digest(provenance: str) -> str:
    """SHA-256 of a provenance, in hex."""
    return hashlib.sha256(provenance.encode()).hexdigest()


def digest_of_file(path: str | Path) -> str:
    """SHA-256 of the bytes of a file, in hex; NO_FILE where there is none.

    It is read again only where its size, its number or one of its times is other than when it was
    read last.
    """
    if not os.path.isfile(path):
        return NO_FILE
    status = os.stat(path)
    state = f"{status.st_size} {status.st_ino} {status.st_mtime_ns} {status.st_ctime_ns}"
    cache_path = Path(FILES, digest(os.path.abspath(path)))
    cached_state, _, content = (_content(cache_path) or "").rpartition(" ")
    if cached_state != state:
        with open(path, "rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        _write(cache_path, f"{state} {content}")
    return content


def planned_path(job: str) -> str:
    """Where the planned provenance of a job is, by the job's name."""
    return f"{PLANNED}/{JOBS}/{job}.json"


def record_path(planned: str) -> Path:
    """Where the provenance of what a job has made is, by the path of the planned one."""
    return Path(planned.replace(PLANNED, RECORDS))


def plan_code(fingerprint: str, modules: Mapping[str, str]) -> None:
    """Write the digests of the modules that a fingerprint is of."""
    path = Path(PLANNED, CODE, f"{fingerprint}.json")
    if not path.exists():
        _write(path, json.dumps(dict(modules), indent=1, sort_keys=True) + "\n")


def is_other(planned: str, provenance: str) -> bool:
    """Whether a job has made something, of another provenance than the planned one."""
    return _content(record_path(planned)) not in (None, provenance)


def plan(planned: str, provenance: str, products: Iterable[str], stale: bool) -> bool:
    """Whether the planned provenance of a job is the recorded one, all `products` are there, and
    nothing that led to them is `stale`.

    If not it is written, with the time behind it, as Snakemake takes a file of the same content for
    the same, however new. Products of a clock that was put back are dated before it: Snakemake
    refuses what is older than its input.
    """
    products = list(products)
    time_s = time.time()
    for product in filter(os.path.exists, products):
        if os.stat(product).st_mtime >= time_s:
            os.utime(product, (time_s - 1, time_s - 1))
    are_present = all(map(os.path.exists, products))
    is_current = are_present and not stale and _content(record_path(planned)) == provenance
    if not is_current:
        _write(planned, f"{provenance}{time_s}\n")
    elif not os.path.exists(planned):
        _write(planned, provenance)
    return is_current


def planned_content(planned: str | Path) -> dict:
    """A planned provenance as a mapping."""
    return json.JSONDecoder().raw_decode(Path(planned).read_text(encoding="utf-8"))[0]


def _write(path: str | Path, content: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(content, encoding="utf-8")


def _content(path: str | Path) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        return None


@contextlib.contextmanager
def recorded(snakemake: Any) -> Iterator[None]:
    """Run the work of a script, `reported`, and record the provenance of what it made.

    There is no record while the work is going on, nor after it failed.
    """
    with reported(snakemake.log[0]):
        planned = snakemake.input.get("provenance")
        if planned is None:  # of a robot, or with results in a storage
            yield
            return
        record = record_path(planned)
        record.unlink(missing_ok=True)
        yield
        code = Path(RECORDS, CODE, f"{snakemake.params.code}.json")
        if not code.exists():
            _write(code, Path(PLANNED, CODE, code.name).read_text(encoding="utf-8"))
        _write(record, snakemake.params.provenance)
        os.utime(planned, (PAST, PAST))


def records(folder: str | Path = "") -> dict[str, Path]:
    """The record of every product, by its path, of the workflow that ran in a folder."""
    return {
        product: record
        for record in sorted(Path(folder, RECORDS, JOBS).rglob("*.json"))
        for product in json.loads(record.read_text(encoding="utf-8"))["products"]
    }


@cache
def recorded_digests() -> dict[str, str]:
    """The digest of the provenance of every product that has one, by its path."""
    return {
        product: digest(record.read_text(encoding="utf-8")) for product, record in records().items()
    }
