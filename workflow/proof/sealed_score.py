"""The score of an opened block: every claim beside its gate and its target, reached or not."""

from dataclasses import replace

import numpy as np
import pandas as pd

from proof import baselines, judge, measures
from proof.claims import LINE, Rows, score, share_of, where
from proof.intervals import interval_of, median, share
from proof.measures import has_all_right, is_broken, is_kind, misfit_closed
from proof.opened import METHODS, SAID_NOTHING


def fault_found(row: dict) -> bool:
    """Whether the fault planted in a real recording was found, or borne where channels are lost,
    as of `judge.finds_fault`."""
    return judge.finds_fault(row["said"], {"effects": row["control"] or []}, row["fault"])


WORDS = replace(
    measures.WORDS,
    conditions=measures.WORDS.conditions
    | {
        "fault": lambda row: bool(row["fault"]),
        "fault found": lambda row: not is_broken(row) and fault_found(row),
    },
)
CLAIMS = WORDS.claims("""
nothing concealed
  false alarm, of any kind | null | share noticed or broken off | ≤ 0.05 | ≤ 0.02
an effect
  something noticed, gap ≥ 5 | effect, gap ≥ 5 | share noticed | ≥ 0.9 | ≥ 0.98
one effect
  right name or declared class, gap ≥ 8 | single, gap ≥ 8 | share right | ≥ 0.95 | ≥ 0.98 | Φ
  right name or declared class, gap 3 to 5 | single, gap 3 to 5 | share right | ≥ 0.75 | ≥ 0.88 | Φ
two effects
  F1 of the set | pair | F1 | ≥ 0.8 | ≥ 0.92
three effects
  F1 of the set | triple | F1 | ≥ 0.65 | ≥ 0.82
one effect, something named
  instrument or skin, rightly | single, named | share side right | ≥ 0.95 | ≥ 0.99
one effect
  electrode exactly right | single, at electrodes | share sites right | ≥ 0.93 | ≥ 0.99
rightly named
  error over its Cramér-Rao sd, median (efficient: 0.67) | all | median error | ≤ 2 | ≤ 1.3
  90 % intervals that hold the truth | all | mean coverage | 0.75 to 0.98 | 0.85 to 0.95
an effect, hidden frames
  misfit closed (1 = oracle), median | effect | median misfit closed | ≥ 0.85 | ≥ 0.97
  χ²/dof, median | effect | median χ² | ≤ 1.3 | 0.95 to 1.1
  RMSE of the best black box (GP, NN) over ours, median | effect | median boxes | ≥ 2 | ≥ 4
outside the catalogue, and all others
  AUROC | all | AUROC | ≥ 0.9 | ≥ 0.96
outside the catalogue
  flagged | foreign | share flagged | ≥ 0.7 | ≥ 0.88
every recording
  seconds a diagnosis, median | all | median seconds | ≤ 120 | ≤ 30
""")
# What the table does not ask for and a reader may.
BESIDE = WORDS.claims("""
a decoy
  named what it looks like | decoy | share decoy named or broken off
  right name or declared class | decoy | share right
one effect
  right name or declared class, gap 5 to 8 | single, gap 5 to 8 | share right | | | Φ
two effects
  F1 of the set, each gap ≥ 8 | pair, gap ≥ 8 | F1
three effects
  F1 of the set, each gap ≥ 8 | triple, gap ≥ 8 | F1
two or three effects
  the whole set right | pair or triple | share right
one effect
  electrode exactly right, gap ≥ 8 | single, gap ≥ 8, at electrodes | share sites right
  site exactly right | single, sited | share sites right
outside the catalogue
  flagged, SNR ≥ 8 after the best fit | foreign, SNR ≥ 8 | share flagged
nothing outside the catalogue
  falsely flagged | native | share flagged
an effect, hidden frames
  noise-free values within the 90 % bands | effect | median within 90 %
every recording
  diagnosis broken off | all | share broken off
""")
REAL = WORDS.claims("""
a fault in a real recording
  found, at its site | real, fault | share fault found
every recording
  seconds a diagnosis, median | all | median seconds
  diagnosis broken off | all | share broken off
""")


def strata(rows: Rows) -> dict[str, Rows]:
    """The rows by what makes them: `generator: …`, `kind: …`, `gap wanted: …`."""
    parts: dict[str, Rows] = {}
    for key, text in (("generator", "generator"), ("group", "kind"), ("strength", "gap wanted")):
        for value in sorted({row[key] for row in rows if row[key] is not None}):
            name = value if isinstance(value, str) else f"{value:g}"
            parts[f"{text}: {name}"] = [row for row in rows if row[key] == value]
    return parts


def scored(rows: Rows) -> pd.DataFrame:
    """Every line (rows, then LINE) of all rows and of each stratum that has any."""
    tables = []
    for name, members in {"all": rows, **strata(rows)}.items():
        real = where(is_kind("real"))(members)
        table = score([row for row in members if row not in real], CLAIMS + BESIDE)
        if real:
            table = pd.concat([table, score(real, REAL[:1] if len(real) < len(members) else REAL)])
        tables.append((table if name == "all" else table[table["n"] > 0]).assign(rows=name))
    return pd.concat(tables, ignore_index=True)[["rows", *LINE]]


def by_method(rows: Rows) -> pd.DataFrame:
    """One line a method: false alarms on nulls, singles' right names and F1 of sets, where it
    names; misfit closed and times its RMSE is ours, medians over effects."""
    lines = []
    counted = where(measures.has_effect)(rows)
    for method in METHODS:
        names_effects = method == "eitskin" or method in baselines.NAMING
        line: dict = {"method": method}
        line |= _naming([_as_named_by(row, method) for row in rows] if names_effects else [])
        closed = [misfit_closed(row, method) for row in counted]
        times = [row["hidden"][method] / row["hidden"]["eitskin"] for row in counted]
        for key, values in (("misfit_closed", closed), ("rmse_over_ours", times)):
            line |= interval_of(key, median(np.array(values, float)))
        lines.append(line | {"effects": len(counted)})
    return pd.DataFrame(lines)


def _as_named_by(row: dict, method: str) -> dict:
    if method == "eitskin":
        return row
    return {**row, "said": {**SAID_NOTHING, "effects": row["baselines"].get(method) or []}}


def _naming(rows: Rows) -> dict:
    line = interval_of("false_alarms", share_of(measures.is_named)(where(is_kind("null"))(rows)))
    line |= interval_of("right_name", share_of(has_all_right)(where(is_kind("single"))(rows)))
    for kind in ("single", "pair", "triple"):
        line |= interval_of(f"f1_{kind}", measures.f1(where(is_kind(kind))(rows)))
    return line


def by_gap(rows: Rows) -> pd.DataFrame:
    """Single effects by method and gap wanted: median gap reached, n, right names with their
    interval, and the mean of Φ(gap / 2)."""
    single = [
        row for row in where(is_kind("single"))(rows) if np.isfinite(measures.smallest_gap(row))
    ]
    lines = []
    for method in ("eitskin", *baselines.NAMING):
        for strength in sorted({row["strength"] for row in single}):
            members = [_as_named_by(r, method) for r in single if r["strength"] == strength]
            measured = share(sum(map(has_all_right, members)), len(members))
            gap = float(np.median(list(map(measures.smallest_gap, members))))
            lines.append(
                {"method": method, "strength": strength, "gap": gap, "n": len(members)}
                | {"right": measured["value"], "low": measured["low"], "high": measured["high"]}
                | {"ceiling": measures.ceiling(members)}
            )
    columns = ["method", "strength", "gap", "n", "right", "low", "high", "ceiling"]
    return pd.DataFrame(lines, columns=columns)


def closed(rows: Rows) -> pd.DataFrame:
    """One line a case with an effect and a method: the misfit closed on hidden frames."""
    methods = [method for method in METHODS if method not in ("none", "oracle")]
    lines = [
        (row["case"], method, misfit_closed(row, method))
        for row in rows
        if row["truth"]
        for method in methods
    ]
    return pd.DataFrame(lines, columns=["case", "method", "misfit_closed"])
