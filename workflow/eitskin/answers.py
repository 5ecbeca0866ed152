"""What the commands answer with --json: one document on stdout."""

import json
import math
import os
import sys
from pathlib import Path

from eitskin.data.check import Check
from eitskin.errors import InputError

VERSION = 1


def checked(result: Check, file: str) -> dict:
    """What `check` and `import` found of a recording; null where a finding has no finite number."""
    findings = [
        {
            "topic": one.topic,
            "severity": one.severity,
            "sentence": one.sentence,
            "value": _finite(one.value),
            "remedy": one.remedy,
        }
        for one in result.findings
    ]
    return {
        "format": "eit-check",
        "version": VERSION,
        "file": file,
        "usable": result.ok,
        "findings": findings,
    }


def refusal(error: InputError) -> dict:
    """Input that was refused."""
    return {
        "format": "eit-refusal",
        "version": VERSION,
        "file": str(error.file),
        "place": error.place,
        "found": str(error.found),
        "expected": error.expected,
    }


def write(said: dict, in_a_line: bool = False) -> None:
    """Print one document on stdout."""
    indent = None if in_a_line else 2
    json.dump(said, sys.stdout, indent=indent, ensure_ascii=False, allow_nan=False)
    print(flush=True)


def name(file: str) -> str:
    """A recording's name: its file's, without what is no text."""
    return os.fsencode(Path(file).stem).decode("utf-8", "replace")


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
