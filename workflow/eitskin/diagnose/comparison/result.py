"""comparison.json."""

import json
from collections.abc import Mapping
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.data.recording import Recording
from eitskin.diagnose.comparison import difference_words
from eitskin.diagnose.comparison.joint import CALIBRATED
from eitskin.diagnose.comparison.sentences import NOTHING
from eitskin.diagnose.comparison.tested import Comparison, Tested
from eitskin.effects.effect import SITES


def of_difference(names: list[str], sentences: list[str], difference: dict | None) -> dict:
    """comparison.json of two recordings that nobody diagnosed: their difference alone."""
    return {
        "format": "eit-comparison",
        "version": 1,
        "parts": names,
        "sentences": sentences,
        "difference": difference,
        "effects": [],
        "tested": [],
        "p_value": None,
        "held_out": None,
    }


def with_difference(said: dict, recordings: Mapping[str, Recording]) -> dict:
    """comparison.json of two diagnoses, by name, with the difference of their recordings before it:
    unchanged where recordings hold differences, which have no untouched frames to compare."""
    if any(each.metadata["values"] != "absolute" for each in recordings.values()):
        return said
    (before, control), (after, later) = recordings.items()
    told, difference = difference_words.compared(control, later, (before, after))
    changed = [] if said["sentences"] == [NOTHING] else said["sentences"]
    return said | {"sentences": [*told, *changed], "difference": difference}


def result(compared: Comparison) -> dict:
    """comparison.json of diagnoses, as an object; `difference` is null: the parts' parameters are
    compared, not their readings."""
    tested = [_row(compared, test) for test in compared.tested]
    shared, found = compared.all_shared, compared.as_found
    gain, error = found.gain(shared)
    return {
        "format": "eit-comparison",
        "version": 1,
        "parts": compared.names,
        "sentences": [t.sentence for t in compared.tested if t.changed] or [NOTHING],
        "difference": None,
        "effects": [
            {
                "name": e.candidate.name,
                "found_in": list(e.own),
                "alternatives": sorted(e.alternatives),
            }
            for e in compared.effects
        ],
        "tested": tested,
        "p_value": compared.p_value,
        "held_out": {
            "frames": len(found.chi2),
            "readings": found.readings,
            "chi2_per_dof_all_shared": shared.chi2_per_dof,
            "chi2_per_dof_as_found": found.chi2_per_dof,
            "elpd_gain": gain,
            "elpd_se": error,
        },
    }


def _row(compared: Comparison, test: Tested) -> dict:
    """One value tested, for comparison.json."""
    candidate = None if test.effect == CALIBRATED else compared.effects[test.effect].candidate
    row: dict = {"name": candidate.name if candidate else test.keys[0]}
    row |= {"parameters": list(test.keys), **{kind: [] for kind in SITES}}
    if candidate and candidate.kind is not None and candidate.scope != "common":
        row[candidate.kind] = list(candidate.own_sites if test.site is None else (test.site,))
    row["calibration"] = candidate is None
    row |= {"changed": test.changed, "chi2": test.chi2, "dof": test.dof, "p": test.p, "q": test.q}
    values = test.combined or [{} for _ in test.groups]
    row["runs"] = [
        {"parts": list(run), "values": value, "there": test.there.get(run[0], True)}
        for run, value in zip(test.groups, values, strict=True)
    ]
    row["parts"] = test.values
    row["sentence"] = test.sentence
    return row


def write(said: dict, path: str | Path) -> None:
    """Write comparison.json, whole or not at all."""
    with atomic_path(path) as temporary:
        text = json.dumps(said, indent=2, ensure_ascii=False, allow_nan=False)
        temporary.write_text(text + "\n", "utf-8")
