"""The answers of the commands with --json: one document on stdout."""

import json
import math
import os
from pathlib import Path

from eitskin.data.check import Check
from eitskin.errors import UNPRINTABLE, InputError

VERSION = 1


def checked(check: Check, file: str) -> dict:
    """The findings of a check as a document; null where a finding has no finite number."""
    findings = [
        {
            "topic": finding.topic,
            "severity": finding.severity,
            "sentence": finding.sentence,
            "value": _finite(finding.value),
            "remedy": finding.remedy,
        }
        for finding in check.findings
    ]
    return {
        "format": "eit-check",
        "version": VERSION,
        "file": file,
        "usable": check.ok,
        "findings": findings,
    }


def refusal(error: InputError) -> dict:
    """A refusal as a document."""
    return {
        "format": "eit-refusal",
        "version": VERSION,
        "file": str(error.file),
        "place": error.place,
        "found": error.actual,
        "expected": error.expected,
    }


def write(document: dict, in_a_line: bool = False) -> None:
    """Print one document on stdout."""
    indent = None if in_a_line else 2
    text = json.dumps(document, indent=indent, ensure_ascii=False, allow_nan=False)
    print(plain_json(text), flush=True)


def plain_json(text: str) -> str:
    """JSON, and in place of what a terminal obeys JSON's escape of it."""
    return UNPRINTABLE.sub(
        lambda mark: mark[0] if mark[0] == "\n" else f"\\u{ord(mark[0]):04x}", text
    )


def name(file: str) -> str:
    """A recording's name: the stem of its file, with undecodable bytes replaced."""
    return os.fsencode(Path(file).stem).decode("utf-8", "replace")


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
