"""Why a verdict was not right, as the evidence tells once the truth is known."""

import numpy as np

from eitskin.diagnose.search.gates import EVIDENCE
from proof import judge, measures, sealed_score

BROKEN_OFF = "broken off"
UNTOLD = "not told from what the real recording has of its own"
UNNOTICED = "from outside, not noticed"
TAKEN = "from outside, and explained by what was named"
BESIDES = "all named, and something else flagged"
TOO_WIDE = "rightly named, with an alternative that the truth rules out"
FAINT = f"faint: a gap under {measures.SHOWN:g}"
CHANCE = "what was said explains the recording better than the truth does"
ALIKE = "what was said explains the recording as well as the truth does"
SEARCH = "missed by the search: the truth explains the recording better"
UNKNOWN = "the true effects cannot be fitted together"


def is_right(row: dict) -> bool:
    """Whether a verdict is right as a whole: nothing named or flagged that is not there, nothing
    missed; of physics outside the catalogue, that it was noticed; of a fault planted in a real
    recording, whose own faults nobody knows, that it was found, or borne."""
    if measures.is_broken(row):
        return False
    if row["fault"]:
        return sealed_score.fault_found(row)
    if row["outside"]:
        return measures.is_flagged(row)
    return measures.has_all_right(row) and not measures.is_flagged(row)


def better_by(row: dict) -> float:
    """Nats of log evidence by which the true set explains a recording better than what was said;
    NaN where either could not be fitted or the truth is none of the catalogue's."""
    evidence = row["log_evidence"], row["said_log_evidence"]
    return float("nan") if None in evidence else evidence[0] - evidence[1]


def cause(row: dict) -> str:
    """One of this module's causes, for a row of `opened.rows` whose verdict is not right."""
    if measures.is_broken(row):
        return BROKEN_OFF
    if row["fault"]:
        return UNTOLD
    if row["outside"]:
        return UNNOTICED if row["snr_left"] >= measures.APART else TAKEN
    matches, entries = judge.matched(row), row["said"]["effects"]
    missed_gaps = [
        judge.next_gap(gaps)
        for match, gaps in zip(matches, row["true_gaps"], strict=True)
        if match is None
    ]
    false_names = len(entries) - len(matches) + len(missed_gaps)
    if not missed_gaps and not false_names:
        return BESIDES
    if sorted(e["name"] for e in entries) == sorted(e["name"] for e in row["truth"]):
        return TOO_WIDE
    if not false_names and np.max(missed_gaps) < measures.SHOWN:
        return FAINT
    nats = better_by(row)
    if np.isnan(nats):
        return UNKNOWN
    if abs(nats) < EVIDENCE.threshold:
        return ALIKE
    return SEARCH if nats > 0 else CHANCE
