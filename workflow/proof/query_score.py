"""Whether what a diagnosis predicts of states that it never saw is worse than what its owner's
calibrated beliefs predict, for sound recordings and others, by kind.
"""

import numpy as np
import pandas as pd

from proof.lines import SUMMARY, line, share
from proof.queries import KINDS

WORSE = 2.0  # standard errors
MOST_WORSE = 0.02  # of the recordings
MOST_RATIO = 1.1  # of the rms errors
QUERY = (
    *("kind", "seed", "drawn", "outcome", "rmse_before_V", "rmse_V", "ratio", "standard_errors"),
    *("units", "verdict", "names", "seconds", "why"),
)


def scored(rows: list[dict]) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES`, and a note."""
    table = queries(rows)
    absent = int((table["outcome"] == "absent").sum())
    note = f"real recordings that are absent, of these: {absent}"
    return {"summary": summary(table), "queries": table}, note


def queries(rows: list[dict]) -> pd.DataFrame:
    """One row (QUERY) a recording. outcome: predicted, refused (an InputError), failed (another
    error) or absent (a real recording that is not there); ratio: rms error after over before; why:
    the error's text."""
    return pd.DataFrame([_query(row) for row in rows], columns=list(QUERY))


def _query(row: dict) -> dict:
    outcome = next((o for o in ("failed", "refused", "absent") if o in row), "predicted")
    head = {key: row.get(key) for key in ("kind", "seed", "drawn", "seconds")}
    head |= {"kind": row["kind"].partition(":")[2], "outcome": outcome, "why": row.get(outcome, "")}
    if outcome != "predicted":
        return head
    names = ", ".join(effect["name"] for effect in row["said"]["effects"])
    return {
        **head,
        **row["hidden"],
        "ratio": ratio(row["hidden"]),
        "verdict": row["said"]["verdict"],
        "names": names,
    }


def ratio(hidden: dict) -> float:
    """The rms error after over that before; 1 where both are 0."""
    after, before = hidden["rmse_V"], hidden["rmse_before_V"]
    return 1.0 if after == before else after / before if before else float("inf")


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Shares and the largest ratio (SUMMARY) of `queries`: of all, and of each kind."""
    lines = _lines("all queries", table, asked=True)
    for kind in KINDS:
        lines += _lines(kind, table[table["kind"] == kind], asked=False)
    return pd.DataFrame(lines, columns=list(SUMMARY))


def _lines(of: str, table: pd.DataFrame, asked: bool) -> list[dict]:
    """asked: whether the bounds are asked for. A query of no verdict counts as not worse."""
    count = table["outcome"].value_counts()
    predicted = table[table["outcome"] == "predicted"]
    n, tried = len(predicted), len(table) - int(count.get("absent", 0))
    apart = predicted["standard_errors"].to_numpy(float)
    largest = predicted["ratio"].max() if n else np.nan
    said = int((predicted["names"] != "").sum())

    def bound(most: float) -> tuple[float, float] | None:
        return (-np.inf, most) if asked else None

    worse = f"after worse than before by over {WORSE:g} standard errors"
    return [
        share(of, worse, int((apart > WORSE).sum()), n, bound(MOST_WORSE)),
        share(of, f"after better by over {WORSE:g} standard errors", (apart < -WORSE).sum(), n),
        share(of, "no verdict, of one unit", np.isnan(apart).sum(), n),
        line(
            of,
            "rms error after over before, largest",
            largest,
            np.nan,
            np.nan,
            n,
            bound(MOST_RATIO),
        ),
        share(of, "an effect named", said, n),
        share(of, "refused with a message", count.get("refused", 0), tried),
        share(of, "tracebacks", count.get("failed", 0), tried, bound(0.0)),
    ]
