"""Diagnose concealed recordings as their owner would: from a recording and its query alone."""

import hashlib
import json
import shutil
import time
import traceback
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.verdict import result
from eitskin.errors import InputError

MADE = "made.json"
FINAL = "final"
SECONDS = "seconds"  # folder of what each took, which no seal is over: it is never the same twice


def run(names: list[str], block: Path, schema: Path, seed: int, code: str) -> None:
    """The verdict of every case in the folder of its block, each whole before the next begins.

    verdicts/<name> holds what `eitskin.diagnose.verdict.result.write` writes, and made.json: {code,
    recording, query}, the fingerprint of the diagnosis and the SHA-256 of what it was given. A case
    that breaks off leaves {recording, failed: why} for diagnosis.json. A verdict of the same files
    by the same code stays, in the final block one by any code. InputError in a sealed block.
    """
    refuse_sealed(block)
    for name in names:
        folder = block / "verdicts" / name
        files = block / "recordings" / f"{name}.parquet", block / "queries" / f"{name}.parquet"
        digests = (hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
        made = {"code": code, **dict(zip(("recording", "query"), digests, strict=True))}
        if _stands(folder, made, block.name == FINAL):
            continue
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        began = time.perf_counter()
        _diagnose(name, *files, folder, schema, seed)
        took = {"seconds": round(time.perf_counter() - began, 2)}
        with atomic_path(block / SECONDS / f"{name}.json") as path:
            path.write_text(json.dumps(took) + "\n", "utf-8")
        with atomic_path(folder / MADE) as path:
            path.write_text(json.dumps(made, indent=1) + "\n", "utf-8")


def refuse_sealed(block: Path) -> None:
    """InputError for a block whose verdicts are sealed, and its truths perhaps open."""
    seal = block / "seal.json"
    if seal.is_file():
        raise InputError(seal, "file", "a sealed block", "one whose truths nobody has seen")


def _stands(folder: Path, made: dict, any_code: bool) -> bool:
    """Whether a whole verdict of these files, and by this code, is there."""
    path = folder / MADE
    if not path.is_file() or not (folder / "diagnosis.json").is_file():
        return False
    return same(json.loads(path.read_text("utf-8")), made, any_code)


def same(known: dict, made: dict, any_code: bool) -> bool:
    """Whether two results are of the same files and, unless any will do, by the same code."""
    return known == ({**made, "code": known["code"]} if any_code else made)


def _diagnose(name: str, path: Path, query: Path, folder: Path, schema: Path, seed: int) -> None:
    try:
        recorded = recording.read(path)
        result.read_query(query, recorded)
        found = diagnosis.diagnose(recorded, seed, progress=True)
        result.write(found, name, folder, schema, query)
    except (MemoryError, OSError):  # of the machine, not of the recording
        raise
    except Exception as error:  # whatever it is, it is a verdict
        traceback.print_exc()
        shutil.rmtree(folder)
        with atomic_path(folder / "diagnosis.json") as failed:
            text = json.dumps({"recording": name, "failed": repr(error)}, ensure_ascii=False)
            failed.write_text(text + "\n", "utf-8")
