"""comparison.json."""

import json
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.data.recording import Recording
from eitskin.diagnose.compare import words
from eitskin.diagnose.compare.difference import difference


def comparison(control: Recording, later: Recording, names: tuple[str, str]) -> dict:
    """comparison.json of two recordings by their names; InputError as `difference`."""
    found = difference(control, later, names)
    return {
        "format": "eit-comparison",
        "version": 1,
        "parts": list(names),
        "sentences": words.sentences(found),
        "difference": words.entries(found),
        # Version 1 once held fitted parameters too: what reads it may ask for these keys.
        "effects": [],
        "tested": [],
        "p_value": None,
        "held_out": None,
    }


def write(comparison: dict, path: str | Path) -> None:
    """Write comparison.json, whole or not at all."""
    with atomic_path(path) as temporary:
        text = json.dumps(comparison, indent=2, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", "utf-8")
