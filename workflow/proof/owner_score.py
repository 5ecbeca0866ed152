"""Whether owners are told what is so: recordings as they have them, held against what each
conceals.

What is right, of a recording that a check lets pass: the names that must be said are said, each by
an effect or one of its alternatives, and no effect is named that the recording does not have. Of
clipped channels: their ceiling, and no such effect. Of a step: its frame and no other; its fault is
counted beside. Of a wrong table: that the check ends there, for that reason.
"""

import numpy as np
import pandas as pd

from eitskin.effects.effect import SITES
from proof.lines import SUMMARY, share
from proof.query_score import WORSE, ratio
from witness.owned import KINDS

LEAST_RIGHT = 0.85
CEILING = 0.02  # off the true one, that a ceiling may be
OUTCOMES = ("failed", "unusable", "refused")
OWNER = (
    *("kind", "seed", "drawn", "outcome", "right", "truth", "names", "false", "step", "steps"),
    *("fault_by_step", "fault_after"),
    *("ceiling_V", "ceilings_V", "rmse_before_V", "rmse_V", "ratio", "standard_errors"),
    *("units", "verdict", "seconds", "why"),
)


def scored(rows: list[dict]) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES`, and a note."""
    table = owners(rows)
    note = "compared on later presses, or on channels kept out where nobody presses"
    return {"summary": summary(table), "owners": table}, note


def owners(rows: list[dict]) -> pd.DataFrame:
    """One row (OWNER) a recording. outcome: predicted, unusable (the check's errors), refused (an
    InputError) or failed (another error); names: of each effect, with its alternatives; false: of
    effects that are none of the truth's; fault_by_step, fault_after: whether a step's fault is
    named at its sites by what the step changed, and of the part after it; why: the error's text."""
    return pd.DataFrame([_owner(row) for row in rows], columns=list(OWNER))


def _owner(row: dict) -> dict:
    outcome = next((o for o in OUTCOMES if o in row), "predicted")
    kind = row["kind"].partition(":")[2]
    head = {key: row.get(key) for key in ("seed", "drawn", "seconds")}
    head |= {"kind": kind, "outcome": outcome, "right": False, "false": 0}
    if outcome == "failed":
        return {**head, "why": row["failed"]}
    truth, checked = row["truth"], row["check"]
    why = row.get(outcome, "")
    if outcome == "unusable":
        why = " ".join(f"{topic}: {sentence}" for topic, sentence in row["unusable"])
    effects = row["said"]["effects"] if outcome == "predicted" else []
    declared = [{effect["name"], *effect["alternatives"]} for effect in effects]
    told = {
        "truth": _listed(truth["effects"]),
        "step": truth["step"],
        "steps": _numbers(checked["steps"]),
        "ceiling_V": truth["ceiling_V"],
        "ceilings_V": _numbers(checked["ceilings"]),
        "false": len(_false(declared, truth)),
        "right": _right(row, outcome, declared),
        "names": "; ".join("/".join([e["name"], *e["alternatives"]]) for e in effects),
        "why": why,
    }
    if outcome != "predicted":
        return head | told
    if truth["step"] is not None:
        told |= _fault(row["said"], truth["effects"][0])
    hidden = row["hidden"]
    return head | told | hidden | {"ratio": ratio(hidden), "verdict": row["said"]["verdict"]}


def _fault(said: dict, fault: dict) -> dict:
    """Whether the fault that a step begins is named at its sites: by what the one step changed, and
    of the part after it, which must hold nothing else."""
    changed, after = [], []
    if len(said.get("steps", [])) == 1:
        changed = [one for one in said["steps"][0]["difference"]["found"] if one["named"]]
        after = said["parts"][1].get("effects", [])
    return {
        "fault_by_step": len(changed) == 1 and _is(changed[0], fault),
        "fault_after": len(after) == 1 and _is(after[0], fault),
    }


def _is(one: dict, fault: dict) -> bool:
    """Whether what is found is the fault, by its name or an alternative, at its sites."""
    sites = all(set(one[kind]) == set(fault.get(kind, [])) for kind in SITES)
    return sites and fault["name"] in {one["name"], *one["alternatives"]}


def _listed(effects: list[dict]) -> str:
    return ", ".join(effect["name"] for effect in effects)


def _numbers(values: list) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _false(declared: list[set[str]], truth: dict) -> list[set[str]]:
    """Effects, as sets of their names and alternatives, that are none of the truth's."""
    true = {effect["name"] for effect in truth["effects"]}
    return [names for names in declared if not names & true]


def _right(row: dict, outcome: str, declared: list[set[str]]) -> bool:
    truth, checked = row["truth"], row["check"]
    if truth["wrong"] is not None:
        errors = row.get("unusable", [])
        return truth["wrong"] in {topic for topic, _ in errors}
    if outcome != "predicted":
        return False
    if truth["step"] is not None:
        return checked["steps"] == [truth["step"]]
    if _false(declared, truth):
        return False
    if truth["ceiling_V"] is not None:
        return any(_near(value, truth["ceiling_V"]) for value in checked["ceilings"])
    return all(any(name in names for names in declared) for name in truth["wanted"])


def _near(value: float, true: float) -> bool:
    return abs(value - true) <= CEILING * true


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Shares (SUMMARY) of `owners`: of all, of steps, and of each kind."""
    lines = _lines("all recordings", table, asked=True)
    kinds, stepped = table["kind"], table[table["kind"] == "step"]
    exact = stepped["steps"] == stepped["step"].map(lambda frame: _numbers([frame]))
    lines.append(
        share("step", "its frame said and no other", exact.sum(), len(stepped), (1.0, np.inf))
    )
    for column, what in (
        ("fault_by_step", "its fault named at its sites, by what the step changed"),
        ("fault_after", "its fault alone named at its sites, of the part after it"),
    ):
        lines.append(share("step", what, stepped[column].eq(True).sum(), len(stepped)))
    for kind, column, what in (("step", "steps", "a step"), ("clipped", "ceilings_V", "a ceiling")):
        said = table[column].fillna("") != ""
        other = kinds != kind
        lines.append(share(f"all but {kind}", f"{what} said", (said & other).sum(), other.sum()))
    for kind in KINDS:
        lines += _lines(kind, table[table["kind"] == kind], asked=False)
    return pd.DataFrame(lines, columns=list(SUMMARY))


def _lines(of: str, table: pd.DataFrame, asked: bool) -> list[dict]:
    """asked: whether the bounds are asked for. What was not predicted has no *after*, and one of
    no verdict counts as not worse."""
    count = table["outcome"].value_counts()
    predicted = table[table["outcome"] == "predicted"]
    apart, n = predicted["standard_errors"].to_numpy(float), len(table)

    def bound(low: float, high: float) -> tuple[float, float] | None:
        return (low, high) if asked else None

    worse = f"after worse than before by over {WORSE:g} standard errors"
    better = f"after better by over {WORSE:g} standard errors"
    right = table["right"].to_numpy(bool).sum()
    none = bound(-np.inf, 0.0)
    return [
        share(of, "right name or class, or refusal", right, n, bound(LEAST_RIGHT, np.inf)),
        share(of, "an effect named that is none of it", (predicted["false"] > 0).sum(), n),
        share(of, worse, (apart > WORSE).sum(), len(predicted), none),
        share(of, better, (apart < -WORSE).sum(), len(predicted)),
        share(of, "ended by the check", count.get("unusable", 0), n),
        share(of, "refused by the diagnosis", count.get("refused", 0), n),
        share(of, "tracebacks", count.get("failed", 0), n, none),
    ]
