"""Whether what a diagnosis predicts of states that it never saw is worse than what its owner's
calibrated beliefs predict; and whether owners are told what is so.

Blocks of queries ask the first of sound recordings and others, by kind. Blocks of owners ask both
of recordings as owners have them. What is right, of a recording that a check lets pass: the names
that must be named are named, each by an effect or one of its alternatives, and no effect is named
that the recording does not have. Of clipped channels: their ceiling, and no such effect. Of a step:
its frame and no other; its fault is counted beside. Of a wrong table: that the check ends there,
for that reason.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd

from eitskin.effects.effect import SITES
from proof.claims import Claim, Condition, Rows, Words, summary
from proof.queries import KINDS
from witness import owned

WORSE = 2.0  # standard errors: 1 in 44 by chance
MOST_RATIO = 1.1  # of the rms errors, which a query of few readings reaches by chance
CEILING = 0.02  # off the true one, that a ceiling may be
OUTCOMES = ("failed", "unusable", "refused", "absent")
QUERY = (
    *("kind", "seed", "drawn", "outcome", "rmse_before_V", "rmse_V", "ratio", "standard_errors"),
    *("units", "verdict", "names", "seconds", "why"),
)
OWNER = (
    *("kind", "seed", "drawn", "outcome", "right", "truth", "names", "false", "step", "steps"),
    *("fault_by_step", "fault_after"),
    *("ceiling_V", "ceilings_V", "rmse_before_V", "rmse_V", "ratio", "standard_errors"),
    *("units", "verdict", "seconds", "why"),
)


def scored(sort: str, rows: Rows) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES` of a sort, queries or owners, and a note."""
    table = TABLE_OF[sort](rows)
    note = "compared on later presses, or on channels kept out where nobody presses"
    if sort == "queries":
        absent = int((table["outcome"] == "absent").sum())
        note = f"real recordings that are absent, of these: {absent}"
    lines = summary((table.to_dict("records"), CLAIMS_OF[sort]))
    return {"summary": lines, sort: table}, note


def queries(rows: Rows) -> pd.DataFrame:
    """One row (QUERY) a recording. outcome: predicted, refused (an InputError), failed (another
    error) or absent (a real recording that is not there); ratio: rms error after over before; why:
    the error's text."""
    lines = [
        _head(row)
        | _prediction(row)
        | {"names": ", ".join(entry["name"] for entry in _entries(row))}
        for row in rows
    ]
    return pd.DataFrame(lines, columns=list(QUERY))


def owners(rows: Rows) -> pd.DataFrame:
    """One row (OWNER) a recording. outcome: predicted, unusable (the check's errors), refused (an
    InputError) or failed (another error); names: of each effect, with its alternatives; false: of
    effects that are none of the truth's; fault_by_step, fault_after: whether a step's fault is
    named at its sites by what the step changed, and of the part after it; why: the error's text."""
    return pd.DataFrame([_owner(row) for row in rows], columns=list(OWNER))


def _outcome(row: dict) -> str:
    return next((outcome for outcome in OUTCOMES if outcome in row), "predicted")


def _head(row: dict) -> dict:
    outcome = _outcome(row)
    why = row.get(outcome, "")
    if outcome == "unusable":
        why = " ".join(f"{topic}: {sentence}" for topic, sentence in why)
    head = {key: row.get(key) for key in ("seed", "drawn", "seconds")}
    return head | {"kind": row["kind"].partition(":")[2], "outcome": outcome, "why": why}


def _entries(row: dict) -> list[dict]:
    return row["said"]["effects"] if _outcome(row) == "predicted" else []


def _prediction(row: dict) -> dict:
    if _outcome(row) != "predicted":
        return {}
    ratio = rmse_ratio(row["hidden"])
    return {**row["hidden"], "ratio": ratio, "verdict": row["said"]["verdict"]}


def rmse_ratio(hidden: dict) -> float:
    """The rms error after over that before; 1 where both are 0."""
    after, before = hidden["rmse_V"], hidden["rmse_before_V"]
    return 1.0 if after == before else after / before if before else float("inf")


def _owner(row: dict) -> dict:
    line = {**_head(row), "right": False, "false": 0, **_prediction(row)}
    if line["outcome"] == "failed":
        return line
    truth, checked, entries = row["truth"], row["check"], _entries(row)
    declared = [{entry["name"], *entry["alternatives"]} for entry in entries]
    line |= {
        "truth": ", ".join(effect["name"] for effect in truth["effects"]),
        "step": truth["step"],
        "steps": _numbers(checked["steps"]),
        "ceiling_V": truth["ceiling_V"],
        "ceilings_V": _numbers(checked["ceilings"]),
        "false": len(_false(declared, truth)),
        "right": _right(row, line["outcome"], declared),
        "names": "; ".join("/".join([e["name"], *e["alternatives"]]) for e in entries),
    }
    if line["outcome"] == "predicted" and truth["step"] is not None:
        line |= _fault(row["said"], truth["effects"][0])
    return line


def _fault(diagnosis: dict, fault: dict) -> dict:
    """Whether the fault that a step begins is named at its sites: by what the one step changed, and
    of the part after it, which must hold nothing else."""
    changed, after = [], []
    if len(diagnosis.get("steps", [])) == 1:
        entries = diagnosis["steps"][0]["difference"]["found"]
        changed = [entry for entry in entries if entry["named"]]
        after = diagnosis["parts"][1].get("effects", [])
    return {
        "fault_by_step": len(changed) == 1 and _is_fault(changed[0], fault),
        "fault_after": len(after) == 1 and _is_fault(after[0], fault),
    }


def _is_fault(entry: dict, fault: dict) -> bool:
    """Whether an entry is the fault, by its name or an alternative, at its sites."""
    sites = all(set(entry[kind]) == set(fault.get(kind, [])) for kind in SITES)
    return sites and fault["name"] in {entry["name"], *entry["alternatives"]}


def _numbers(values: list) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _false(declared: list[set[str]], truth: dict) -> list[set[str]]:
    """Effects, as sets of their names and alternatives, that are none of the truth's."""
    true = {effect["name"] for effect in truth["effects"]}
    return [names for names in declared if not names & true]


def _right(row: dict, outcome: str, declared: list[set[str]]) -> bool:
    truth, checked = row["truth"], row["check"]
    if truth["wrong"] is not None:
        return truth["wrong"] in {topic for topic, _ in row.get("unusable", [])}
    if outcome != "predicted":
        return False
    if truth["step"] is not None:
        return checked["steps"] == [truth["step"]]
    if _false(declared, truth):
        return False
    ceiling = truth["ceiling_V"]
    if ceiling is not None:
        return any(abs(value - ceiling) <= CEILING * ceiling for value in checked["ceilings"])
    return all(any(name in names for names in declared) for name in truth["wanted"])


def _is_outcome(outcome: str) -> Condition:
    return lambda line: line["outcome"] == outcome


def _is_true(column: str) -> Condition:
    return lambda line: line[column] is True


def _has_text(column: str) -> Condition:
    return lambda line: isinstance(line[column], str) and line[column] != ""


WORDS = Words(  # of lines of the two tables
    conditions={
        **{outcome: _is_outcome(outcome) for outcome in ("predicted", *OUTCOMES)},
        "present": lambda line: line["outcome"] != "absent",
        "worse": lambda line: line["standard_errors"] > WORSE,
        "better": lambda line: line["standard_errors"] < -WORSE,
        "no verdict": lambda line: bool(np.isnan(line["standard_errors"])),
        "named": _has_text("names"),
        "false name": lambda line: line["outcome"] == "predicted" and line["false"] > 0,
        "right": _is_true("right"),
        "step": lambda line: line["kind"] == "step",
        "no step": lambda line: line["kind"] != "step",
        "not clipped": lambda line: line["kind"] != "clipped",
        "step exact": lambda line: line["steps"] == _numbers([line["step"]]),
        "fault by step": _is_true("fault_by_step"),
        "fault after": _is_true("fault_after"),
        "steps said": _has_text("steps"),
        "ceiling said": _has_text("ceilings_V"),
    },
    numbers={"ratio": lambda line: line["ratio"]},
)
# Of all recordings, and without the bounds of each kind. What was not predicted has no *after*; one
# of no verdict counts as not worse.
QUERIES = WORDS.claims("""
all queries
  after worse than before by over 2 standard errors | predicted | share worse | ≤ 0.02
  the same, of those with a name | predicted, named | share worse
  after better by over 2 standard errors | predicted | share better
  no verdict, of one unit | predicted | share no verdict
  rms error after over before, largest | predicted | largest ratio | ≤ 1.1
  an effect named | predicted | share named
  refused with a message | present | share refused
  tracebacks | present | share failed | ≤ 0
""")
OWNERS = WORDS.claims("""
all recordings
  right name or class, or refusal | all | share right | ≥ 0.85
  an effect named that is none of it | all | share false name
  after worse than before by over 2 standard errors | predicted | share worse | ≤ 0
  after better by over 2 standard errors | predicted | share better
  ended by the check | all | share unusable
  refused by the diagnosis | all | share refused
  tracebacks | all | share failed | ≤ 0
""")
STEPS = WORDS.claims("""
step
  its frame said and no other | step | share step exact | ≥ 1
  its fault named at its sites, by what the step changed | step | share fault by step
  its fault alone named at its sites, of the part after it | step | share fault after
all but step
  a step said | no step | share steps said
all but clipped
  a ceiling said | not clipped | share ceiling said
""")


def _of_kind(claim: Claim, kind: str) -> Claim:
    def is_kind(line: dict) -> bool:
        return line["kind"] == kind

    conditions = (is_kind, *claim.conditions)
    return replace(claim, subject=kind, conditions=conditions, gate=None)


CLAIMS_OF = {
    "queries": [*QUERIES, *(_of_kind(claim, kind) for kind in KINDS for claim in QUERIES)],
    "owners": [
        *(*OWNERS, *STEPS),
        *(_of_kind(claim, kind) for kind in owned.KINDS for claim in OWNERS),
    ],
}
TABLE_OF: dict[str, Callable[[Rows], pd.DataFrame]] = {"queries": queries, "owners": owners}
