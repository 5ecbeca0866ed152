"""Diagnose concealed recordings as their owner would: from a recording and its query alone."""

import shutil
import time
from functools import partial
from pathlib import Path

from eitskin.data import recording
from eitskin.diagnose import diagnosis, files
from eitskin.diagnose.verdict.record import read_query, record
from eitskin.errors import InputError
from proof import ledger

PROVENANCE = "made.json"
FINAL = "final"  # the block of which nothing is ever made again, by whatever code
SECONDS = "seconds"  # folder of what each took, which no seal is over: it is never the same twice


def run(cases: list[str], block: Path, schema: Path, seed: int, code: str) -> None:
    """The verdict of every case in the folder of its block, each whole before the next begins.

    verdicts/CASE holds what `files.write` writes, and made.json: {code, recording, query}, the
    fingerprint of the diagnosis and the SHA-256 of what it was given. A case that breaks off leaves
    {recording, failed: why} for diagnosis.json. A verdict of the same files by the same code stays,
    in the final block one by any code. InputError in a sealed block.
    """
    refuse_sealed(block)
    for case in cases:
        folder, paths = block / "verdicts" / case, ledger.files_of(block, case)
        provenance = ledger.sources(code, **paths)
        is_whole = (folder / "diagnosis.json").is_file()
        if is_whole and ledger.stands(folder / PROVENANCE, provenance, block.name == FINAL):
            continue
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        start = time.perf_counter()
        failure = ledger.outcome(partial(_diagnose, case, paths, folder, schema, seed))
        if failure:
            shutil.rmtree(folder)
            ledger.write(folder / "diagnosis.json", {"recording": case, **failure})
        seconds = round(time.perf_counter() - start, 2)
        ledger.write(block / SECONDS / f"{case}.json", {"seconds": seconds})
        ledger.write(folder / PROVENANCE, provenance, indent=1)


def refuse_sealed(block: Path) -> None:
    """InputError for a block whose verdicts are sealed, and its truths perhaps open."""
    seal = block / "seal.json"
    if seal.is_file():
        raise InputError(seal, "file", "a sealed block", "one whose truths nobody has seen")


def _diagnose(case: str, paths: dict[str, Path], folder: Path, schema: Path, seed: int) -> dict:
    recorded = recording.read(paths["recording"])
    query = read_query(paths["query"], recorded)
    diagnosed = diagnosis.diagnose(recorded, seed, progress=True)
    files.write(record(diagnosed, case, query), folder, schema, paths["query"])
    return {}
