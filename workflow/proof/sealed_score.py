"""The score of an opened block: every claim beside its gate and its target, reached or not."""

import numpy as np
import pandas as pd

from eitskin.effects.effect import SITES
from proof import baselines, measures, planted
from proof.claims import (
    LINE,
    Rows,
    at_least,
    at_most,
    claims,
    mean_over,
    median_of,
    median_over,
    score,
    share_of,
    where,
)
from proof.intervals import Bounds, interval_of, median, share
from proof.measures import (
    APART,
    SHOWN,
    has_all_right,
    has_effect,
    has_gap,
    hidden,
    is_alarm,
    is_broken,
    is_foreign,
    is_kind,
    is_noticed,
    is_sited,
    misfit_closed,
)
from proof.opened import METHODS, SAID_NOTHING

ALL, WITH_EFFECT = where(), where(has_effect)
NULL, SINGLE, DECOY = (where(is_kind(kind)) for kind in ("null", "single", "decoy"))
PAIR, TRIPLE = where(is_kind("pair")), where(is_kind("triple"))
RIGHT, SITES_RIGHT = share_of(has_all_right), share_of(measures.has_sites_right)
FLAGGED = share_of(measures.is_flagged)
F1, HIDDEN = "F1 of the set", "an effect, hidden frames"


def fault_found(row: dict) -> bool:
    """Whether the fault planted in a real recording was found, or borne where channels are lost,
    as of `planted.finds_fault`."""
    return planted.finds_fault(row["said"], {"effects": row["control"] or []}, row["fault"])


def _is_found(row: dict) -> bool:
    return not is_broken(row) and fault_found(row)


def _has_fault(row: dict) -> bool:
    return bool(row["fault"])


def _seconds(row: dict) -> float:
    return row.get("seconds", np.nan)


def _right_name(low: float, high: float, *bounds: Bounds | None) -> tuple:
    gaps = f"gap ≥ {low:g}" if high == np.inf else f"gap {low:g} to {high:g}"
    select = where(is_kind("single"), has_gap(low, high))
    return f"right name or declared class, {gaps}", select, RIGHT, *bounds, measures.ceiling


SECONDS = ("seconds a diagnosis, median", ALL, median_of(_seconds))
BROKEN = ("diagnosis broken off", ALL, share_of(is_broken))
CLAIMS = [
    *claims(
        "nothing concealed",
        (
            "false alarm, of any kind",
            *(NULL, share_of(is_alarm(is_noticed)), at_most(0.05), at_most(0.02)),
        ),
    ),
    *claims(
        "an effect",
        (
            f"something noticed, gap ≥ {SHOWN:g}",
            where(has_effect, has_gap(SHOWN)),
            *(share_of(is_noticed), at_least(0.90), at_least(0.98)),
        ),
    ),
    *claims(
        "one effect",
        _right_name(APART, np.inf, at_least(0.95), at_least(0.98)),
        _right_name(3.0, SHOWN, at_least(0.75), at_least(0.88)),
    ),
    *claims("two effects", (F1, PAIR, measures.f1, at_least(0.80), at_least(0.92))),
    *claims("three effects", (F1, TRIPLE, measures.f1, at_least(0.65), at_least(0.82))),
    *claims(
        "one effect, something named",
        (
            "instrument or skin, rightly",
            where(is_kind("single"), measures.is_named),
            *(share_of(measures.has_side_right), at_least(0.95), at_least(0.99)),
        ),
    ),
    *claims(
        "one effect",
        (
            "electrode exactly right",
            where(is_kind("single"), is_sited("electrodes")),
            *(SITES_RIGHT, at_least(0.93), at_least(0.99)),
        ),
    ),
    *claims(
        "rightly named",
        (
            "error over its Cramér-Rao sd, median (efficient: 0.67)",
            *(ALL, median_over(measures.errors), at_most(2.0), at_most(1.3)),
        ),
        (
            "90 % intervals that hold the truth",
            *(ALL, mean_over(measures.coverages), (0.75, 0.98), (0.85, 0.95)),
        ),
    ),
    *claims(
        HIDDEN,
        (
            "misfit closed (1 = oracle), median",
            *(WITH_EFFECT, median_of(misfit_closed), at_least(0.85), at_least(0.97)),
        ),
        (
            "χ²/dof, median",
            *(WITH_EFFECT, median_of(hidden("chi2_per_dof")), at_most(1.3), (0.95, 1.10)),
        ),
        (
            "RMSE of the best black box (GP, NN) over ours, median",
            *(WITH_EFFECT, median_of(measures.boxes_over_ours), at_least(2.0), at_least(4.0)),
        ),
    ),
    *claims(
        "outside the catalogue, and all others",
        ("AUROC", ALL, measures.auroc, at_least(0.90), at_least(0.96)),
    ),
    *claims(
        "outside the catalogue",
        ("flagged", where(is_foreign), FLAGGED, at_least(0.70), at_least(0.88)),
    ),
    *claims("every recording", (*SECONDS, at_most(120.0), at_most(30.0))),
]
# What the table does not ask for and a reader may.
BESIDE = [
    *claims(
        "a decoy",
        ("named what it looks like", DECOY, share_of(is_alarm(measures.has_decoy_named))),
        ("right name or declared class", DECOY, RIGHT),
    ),
    *claims("one effect", _right_name(SHOWN, APART, None, None)),
    *(
        claim
        for kind, subject in (("pair", "two effects"), ("triple", "three effects"))
        for claim in claims(
            subject,
            (f"{F1}, each gap ≥ {APART:g}", where(is_kind(kind), has_gap(APART)), measures.f1),
        )
    ),
    *claims(
        "two or three effects", ("the whole set right", where(is_kind("pair", "triple")), RIGHT)
    ),
    *claims(
        "one effect",
        (
            f"electrode exactly right, gap ≥ {APART:g}",
            where(is_kind("single"), has_gap(APART), is_sited("electrodes")),
            SITES_RIGHT,
        ),
        ("site exactly right", where(is_kind("single"), is_sited(*SITES)), SITES_RIGHT),
    ),
    *claims(
        "outside the catalogue",
        (
            f"flagged, SNR ≥ {APART:g} after the best fit",
            where(is_foreign, measures.has_snr_left(APART)),
            FLAGGED,
        ),
    ),
    *claims(
        "nothing outside the catalogue", ("falsely flagged", where(measures.is_native), FLAGGED)
    ),
    *claims(
        HIDDEN,
        ("noise-free values within the 90 % bands", WITH_EFFECT, median_of(hidden("within_90"))),
    ),
    *claims("every recording", BROKEN),
]
PLANTED = claims(
    "a fault in a real recording",
    ("found, at its site", where(is_kind("real"), _has_fault), share_of(_is_found)),
)
REAL = [*PLANTED, *claims("every recording", SECONDS, BROKEN)]


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
            asked = PLANTED if len(real) < len(members) else REAL
            table = pd.concat([table, score(real, asked)])
        tables.append((table if name == "all" else table[table["n"] > 0]).assign(rows=name))
    return pd.concat(tables, ignore_index=True)[["rows", *LINE]]


def by_method(rows: Rows) -> pd.DataFrame:
    """One line a method: false alarms on nulls, singles' right names and F1 of sets, where it
    names; misfit closed and times its RMSE is ours, medians over effects."""
    lines = []
    counted = WITH_EFFECT(rows)
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
    line = interval_of("false_alarms", share_of(measures.is_named)(NULL(rows)))
    line |= interval_of("right_name", RIGHT(SINGLE(rows)))
    for kind in ("single", "pair", "triple"):
        line |= interval_of(f"f1_{kind}", measures.f1(where(is_kind(kind))(rows)))
    return line


def by_gap(rows: Rows) -> pd.DataFrame:
    """Single effects by method and gap wanted: median gap reached, n, right names with their
    interval, and the mean of Φ(gap / 2)."""
    single = [row for row in SINGLE(rows) if np.isfinite(measures.smallest_gap(row))]
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
