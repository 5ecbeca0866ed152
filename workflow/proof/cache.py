"""Results on the disk that stand as long as the files and the code that they were made of do."""

import hashlib
import json
import traceback
from collections.abc import Callable
from pathlib import Path

from eitskin.atomic import atomic_path
from proof.verdicts import same


def made_of(code: str, **files: Path) -> dict[str, str]:
    """{code, SHA-256 by name} of files; those that are not there are left out."""
    there = {name: path for name, path in files.items() if path.is_file()}
    digests = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in there.items()}
    return {"code": code, **digests}


def stands(path: Path, made: dict, any_code: bool) -> bool:
    """Whether a result is there, of the same files and, unless any will do, by the same code."""
    if not path.is_file():
        return False
    return same(json.loads(path.read_text("utf-8"))["made"], made, any_code)


def write(path: Path, made: dict, work: Callable[[], dict]) -> None:
    """{**what `work` returns, made} as JSON; {failed: why, made} where it breaks off."""
    try:
        row = work()
    except (MemoryError, OSError):  # of the machine, not of the recording
        raise
    except Exception as error:  # whatever it is, it is a result
        traceback.print_exc()
        row = {"failed": repr(error)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        text = json.dumps({**row, "made": made}, ensure_ascii=False)
        temporary.write_text(text + "\n", "utf-8")
