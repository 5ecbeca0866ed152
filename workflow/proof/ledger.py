"""Results in files that stand as long as what they were made of does."""

import hashlib
import json
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from eitskin import cores
from eitskin.atomic import atomic_path

T = TypeVar("T")
MACHINE = (MemoryError, OSError)  # faults of the machine, not of the recording


def outcome(work: Callable[[], dict]) -> dict:
    """What `work` returns; {failed: why} where it breaks off, whatever the reason, but for a fault
    of the machine, which is raised."""
    try:
        return work()
    except MACHINE:
        raise
    except Exception as error:
        traceback.print_exc()
        return {"failed": repr(error)}


def timed(work: Callable[[], T]) -> tuple[T, dict[str, float]]:
    """What `work` returns, and {seconds, cpu_seconds} that it took."""
    start = time.perf_counter(), cores.seconds()
    value = work()
    seconds = {"seconds": time.perf_counter() - start[0]}
    return value, seconds | {"cpu_seconds": cores.seconds() - start[1]}


def files_of(block: Path, case: str) -> dict[str, Path]:
    """Recording and query of a case."""
    folders = {"recording": "recordings", "query": "queries"}
    return {name: block / folder / f"{case}.parquet" for name, folder in folders.items()}


def sources(code: str, **files: Path) -> dict[str, str]:
    """{code, SHA-256 by name} of files; those that are not there are left out."""
    present = {name: path for name, path in files.items() if path.is_file()}
    digests = {n: hashlib.sha256(path.read_bytes()).hexdigest() for n, path in present.items()}
    return {"code": code, **digests}


def stands(path: Path, provenance: dict[str, str], any_code: bool = False) -> bool:
    """Whether a JSON object is there whose `made`, or itself, says these sources and, unless any
    will do, this code."""
    if not path.is_file():
        return False
    recorded = json.loads(path.read_text("utf-8"))
    recorded = recorded.get("made", recorded)
    return recorded == ({**provenance, "code": recorded["code"]} if any_code else provenance)


def write(path: Path, content: dict, indent: int | None = None) -> None:
    """Write a JSON object and a line's end, whole or not at all."""
    with atomic_path(path) as temporary:
        text = json.dumps(content, ensure_ascii=False, indent=indent)
        temporary.write_text(text + "\n", "utf-8")
