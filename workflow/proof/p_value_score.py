"""How often the best candidate's p is small where nothing is left out, from rows of skins."""

import numpy as np
import pandas as pd

from proof.claims import Rows, at_most, claims, share_of, summary, where
from proof.intervals import mean, resampled
from proof.measures import Condition, is_broken
from proof.nulls import RIGS

LEVELS = (0.05, 0.01)  # of p
MOST_OFTEN = 1.5  # times as often as it says, that p may be below a level
NULL = (
    *("seed", "rig", "number", "p_value", "p_local", "name", "failed"),
    *("seconds", "cpu_seconds"),
)


def scored(rows: Rows) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES`, and a note."""
    table = p_values(rows)
    tables = {"summary": p_value_summary(rows), "p_values": table}
    return tables, f"{len(table)} recordings of these skins"


def p_values(rows: Rows) -> pd.DataFrame:
    """One row (NULL) a recording in which nothing is left out, of trial rows of skins."""
    return pd.DataFrame(_recordings(rows), columns=list(NULL))


def _recordings(rows: Rows) -> Rows:
    return [{"seed": row["seed"], **null} for row in rows for null in row.get("nulls", [])]


def p_value_summary(rows: Rows) -> pd.DataFrame:
    """How often the best candidate's p is below each of LEVELS (`claims.SUMMARY`), of all
    recordings and by rig; a recording that breaks off counts as one. Recordings of a skin are
    alike: of all, the interval over skins drawn anew stands beside Wilson's."""
    recordings = _recordings(rows)
    below = claims("every rig", *(line for level in LEVELS for line in _level_lines(level)))
    for rig in RIGS:
        select = where(_is_of(rig))
        below += claims(rig, *((_text(p), select, share_of(_is_below(p))) for p in LEVELS))
    skins = claims("the run", ("skins broken off", where(), share_of(is_broken)))
    run = claims(
        "the run",
        ("recordings broken off", where(), share_of(is_broken)),
        ("processor seconds a recording, mean", where(), _mean_seconds),
    )
    return summary((recordings, below), (rows, skins), (recordings, run))


def _text(level: float) -> str:
    return f"best candidate's p below {level:g}"


def _is_of(rig: str) -> Condition:
    return lambda null: null["rig"] == rig


def _is_below(level: float) -> Condition:
    return lambda null: is_broken(null) or null["p_value"] < level


def _level_lines(level: float) -> tuple[tuple, tuple]:
    def over_skins(recordings: Rows) -> dict:
        seeds = pd.Series([null["seed"] for null in recordings], dtype=object)
        below = pd.Series(list(map(_is_below(level), recordings)), dtype=bool)
        hits, n = (below.groupby(seeds).agg(total).to_numpy() for total in ("sum", "size"))
        return resampled(len(n), lambda index: float(hits[index].sum() / n[index].sum()))

    return (
        (_text(level), where(), share_of(_is_below(level)), at_most(MOST_OFTEN * level)),
        (f"{_text(level)}, skins drawn anew", where(), over_skins),
    )


def _mean_seconds(recordings: Rows) -> dict:
    return mean(np.array([null["cpu_seconds"] for null in recordings], float))
