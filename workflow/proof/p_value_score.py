"""How often the best candidate's p is small where nothing is left out, from rows of skins."""

import pandas as pd

from proof.claims import Condition, Measure, Rows, Words, summary
from proof.intervals import resampled
from proof.measures import is_broken
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
    return summary((recordings, CLAIMS), (rows, SKINS), (recordings, RUN))


def _is_of(rig: str) -> Condition:
    return lambda null: null["rig"] == rig


def _is_below(level: float) -> Condition:
    return lambda null: is_broken(null) or null["p_value"] < level


def _over_skins(level: float) -> Measure:
    def measure(recordings: Rows) -> dict:
        seeds = pd.Series([null["seed"] for null in recordings], dtype=object)
        below = pd.Series(list(map(_is_below(level), recordings)), dtype=bool)
        hits, n = (below.groupby(seeds).agg(total).to_numpy() for total in ("sum", "size"))
        return resampled(len(n), lambda index: float(hits[index].sum() / n[index].sum()))

    return measure


WORDS = Words(
    conditions={
        **{rig: _is_of(rig) for rig in RIGS},
        **{f"p < {level:g}": _is_below(level) for level in LEVELS},
        "broken off": is_broken,
    },
    numbers={"processor seconds": lambda null: null["cpu_seconds"]},
    measures={f"p < {level:g} over skins": _over_skins(level) for level in LEVELS},
)
BELOW = "best candidate's p below"
CLAIMS = WORDS.claims(
    "every rig"
    + "".join(
        f"""
  {BELOW} {level:g} | all | share p < {level:g} | ≤ {MOST_OFTEN * level:g}
  {BELOW} {level:g}, skins drawn anew | all | p < {level:g} over skins"""
        for level in LEVELS
    )
    + "".join(
        "\n".join(["", rig, *(f"    {BELOW} {p:g} | {rig} | share p < {p:g}" for p in LEVELS)])
        for rig in RIGS
    )
)
SKINS = WORDS.claims("""
the run
  skins broken off | all | share broken off
""")
RUN = WORDS.claims("""
the run
  recordings broken off | all | share broken off
  processor seconds a recording, mean | all | mean processor seconds
""")
