"""How often the best candidate's p is small where nothing is left out, from rows of skins."""

import numpy as np
import pandas as pd

from proof.lines import SUMMARY, over, share
from proof.nulls import RIGS

LEVELS, MOST_OFTEN = (0.05, 0.01), 1.5  # of p; times as often as it says
NULL = (
    *("seed", "rig", "number", "p_value", "p_local", "name", "failed"),
    *("seconds", "cpu_seconds"),
)


def scored(rows: list[dict]) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES`, and a note."""
    table = p_values(rows)
    return {"summary": summary(rows), "p_values": table}, f"{len(table)} recordings of these skins"


def p_values(rows: list[dict]) -> pd.DataFrame:
    """One row (NULL) a recording in which nothing is left out, of trial rows of skins."""
    made = [{"seed": row["seed"], **one} for row in rows for one in row.get("nulls", [])]
    return pd.DataFrame(made, columns=list(NULL))


def summary(rows: list[dict]) -> pd.DataFrame:
    """How often the best candidate's p is below each of LEVELS (SUMMARY), of all recordings and by
    rig; a recording that breaks off counts as one. Recordings of a skin are alike: of all, the
    interval over skins drawn anew stands beside Wilson's."""
    table = p_values(rows)
    lines = []
    for level in LEVELS:
        below = (table["p_value"] < level) | table["failed"].notna()
        what, wanted = f"best candidate's p below {level:g}", (-np.inf, MOST_OFTEN * level)
        lines.append(share("every rig", what, below.sum(), len(below), wanted))
        hits, n = (below.groupby(table["seed"]).agg(how).to_numpy() for how in ("sum", "size"))

        def drawn(index: np.ndarray, hits: np.ndarray = hits, n: np.ndarray = n) -> float:
            return float(hits[index].sum() / n[index].sum())

        lines.append(over("every rig", f"{what}, skins drawn anew", len(n), drawn))
    for rig in RIGS:
        own = table[table["rig"] == rig]
        for level in LEVELS:
            below = (own["p_value"] < level) | own["failed"].notna()
            lines.append(share(rig, f"best candidate's p below {level:g}", below.sum(), len(below)))
    broken = sum("failed" in row for row in rows)
    took = table["cpu_seconds"].to_numpy(float)
    lines += [
        share("the run", "skins broken off", broken, len(rows)),
        share("the run", "recordings broken off", table["failed"].notna().sum(), len(table)),
        over(
            "the run",
            "processor seconds a recording, mean",
            len(took),
            lambda i: float(took[i].mean()),
        ),
    ]
    return pd.DataFrame(lines, columns=list(SUMMARY))
