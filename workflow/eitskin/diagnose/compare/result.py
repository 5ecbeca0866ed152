"""comparison.json."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eitskin.atomic import atomic_path
from eitskin.data.recording import Recording
from eitskin.diagnose.compare import words
from eitskin.diagnose.compare.difference import (
    MARGIN_NATS,
    THRESHOLD_NATS,
    Difference,
    Finding,
    difference,
)
from eitskin.diagnose.compare.discs import intervals
from eitskin.diagnose.compare.objects import objects_of


def comparison(control: Recording, later: Recording, names: tuple[str, str]) -> dict:
    """comparison.json of two recordings by their names; InputError as `untouched_pair`."""
    changes = difference(control, later, names)
    return {
        "format": "eit-comparison",
        "version": 1,
        "parts": list(names),
        "sentences": words.sentences(changes),
        "difference": _difference(changes),
        # Version 1 once held fitted parameters too: readers may ask for these keys.
        "effects": [],
        "tested": [],
        "p_value": None,
        "held_out": None,
    }


def _difference(changes: Difference) -> dict:
    """The key `difference`."""
    pair = changes.pair
    return {
        "found": [_finding(finding, changes) for finding in changes.findings],
        "lost_channels": list(changes.lost_channels),
        "common_ratio": changes.common_ratio,
        "odd_share": changes.odd_share(changes.wander.change),
        "moved": dict(zip(("times_scatter", "p_value"), changes.change_test, strict=True)),
        "untouched_frames": [len(pair.control), len(pair.later)],
        "threshold_nats": THRESHOLD_NATS,
        "margin_nats": MARGIN_NATS,
    }


def _finding(finding: Finding, changes: Difference) -> dict:
    rival, fit = finding.rival, finding.object_fit
    return {
        **words.placed(finding.explanation),
        "named": finding.named,
        "alternatives": list(finding.alternatives),
        "ratio": finding.ratio if np.isfinite(finding.ratio) else None,
        "objects": _objects(finding, changes.pair.radius_mm),
        "explained": fit and fit.explained_share,
        "held_out": fit and fit.held_out,
        "since_frame": finding.onset_row,
        "evidence_nats": finding.explanation.evidence,
        "odd_share": changes.odd_share(finding.change),
        "rival": rival and {**words.placed(rival), "evidence_nats": rival.evidence},
        "sentence": words.sentence(finding, changes),
    }


def _objects(finding: Finding, radius_mm: float | None) -> list[dict]:
    """Sign and place of each object, in mm too where the skin's radius is known."""
    if finding.object_fit is None:
        return []
    objects = objects_of(finding.explanation)
    estimates = intervals(objects.coordinates, finding.object_fit.coordinate_sd)
    rows = []
    for disc, parameters in zip(objects.discs, estimates, strict=True):
        row: dict[str, Any] = {"conducting": disc.conducting, "angle_deg": disc.angle_deg}
        for key, ends in parameters.items():
            name = "contrast" if key == "ratio" else f"{key}_of_radius"
            row[name] = _estimate(ends, "1")
            if key != "ratio":
                scaled = [radius_mm * end for end in ends] if radius_mm else None
                row[f"{key}_mm"] = _estimate(scaled, "mm") if scaled else None
        rows.append(row)
    return rows


def _estimate(ends: Sequence[float], unit: str) -> dict:
    """A value with its 90 % interval; an end at a bound (infinite, or the 0 of a ratio) is null."""
    value, low, high = (float(end) for end in ends)
    return {
        "value": value,
        "low": low if low != 0 else None,
        "high": high if np.isfinite(high) else None,
        "unit": unit,
    }


def write(comparison: dict, path: str | Path) -> None:
    """Write comparison.json, whole or not at all."""
    with atomic_path(path) as temporary:
        text = json.dumps(comparison, indent=2, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", "utf-8")
