"""Why a verdict was not right, as the evidence tells once the truth is known."""

import numpy as np

from eitskin.diagnose.search.search import LEAST_EVIDENCE
from proof import judge, score, scoring

BROKEN_OFF = "broken off"
UNTOLD = "not told from what the real recording has of its own"
UNNOTICED = "from outside, not noticed"
TAKEN = "from outside, and explained by what was named"
BESIDES = "all named, and something else flagged"
TOO_WIDE = "rightly named, with an alternative that the truth rules out"
FAINT = f"faint: a gap under {scoring.SHOWN:g}"
CHANCE = "what was said explains the recording better than the truth does"
ALIKE = "what was said explains the recording as well as the truth does"
SEARCH = "missed by the search: the truth explains the recording better"
UNKNOWN = "the true effects cannot be fitted together"


def better_by(row: dict) -> float:
    """Nats of log evidence by which the true set explains a recording better than what was said;
    NaN where either could not be fitted or the truth is none of the catalogue's."""
    evidence = row["log_evidence"], row["said_log_evidence"]
    return float("nan") if None in evidence else evidence[0] - evidence[1]


def cause(row: dict) -> str:
    """One of this module's causes, for a row of `scoring.rows` whose verdict is not right."""
    if "failed" in row:
        return BROKEN_OFF
    if row["fault"]:
        return UNTOLD
    if row["outside"]:
        return UNNOTICED if row["snr_left"] >= score.APART else TAKEN
    found, said = judge.matched(row), row["said"]["effects"]
    missed = [
        judge.next_gap(gaps)
        for one, gaps in zip(found, row["true_gaps"], strict=True)
        if one is None
    ]
    besides = len(said) - len(found) + len(missed)
    if not missed and not besides:
        return BESIDES
    if sorted(one["name"] for one in said) == sorted(item["name"] for item in row["truth"]):
        return TOO_WIDE
    if not besides and np.max(missed) < scoring.SHOWN:
        return FAINT
    nats = better_by(row)
    if np.isnan(nats):
        return UNKNOWN
    if abs(nats) < LEAST_EVIDENCE:
        return ALIKE
    return SEARCH if nats > 0 else CHANCE
