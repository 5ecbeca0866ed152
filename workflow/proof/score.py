"""`python -m proof.score results/calibration/report full` scores what is there of an open block.

Every share and statistic has its interval and its number of recordings.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.diagnose.verdict.words import last_scores
from eitskin.effects import EFFECTS
from proof import control_score, measures, p_value_score, prediction_score, rig_sizes
from proof.blocks import sort_of, trials
from proof.claims import Rows, share_of, summary, where
from proof.intervals import interval_of, share
from proof.markdown import measured_cells, table
from proof.measures import APART, is_alarm, is_broken, is_flagged, is_named
from proof.trial import file_of
from witness.strengths import DRAWN

COMMAND = "snakemake --cores 2 calibrate_diagnosis"
RIG = (
    *("rig_error", "n", "named", "named_low", "named_high"),
    *("flagged", "flagged_low", "flagged_high"),
)


def read(folder: Path, block: str, size: str) -> tuple[Rows, int]:
    """The rows of a plan that are there, in its order, `kind` without what the rig adds; and the
    number planned."""
    planned = trials(block, size)
    paths = [file_of(folder, kind, seed) for kind, seed in planned]
    rows = [json.loads(path.read_text("utf-8")) for path in paths if path.exists()]
    return [{**row, "kind": row["kind"].partition("+")[0]} for row in rows], len(planned)


def _area(rows: Rows) -> dict:
    """AUROC of recordings with foreign physics that the best fit leaves, and those without any."""
    foreign = where(measures.is_foreign, measures.has_snr_left(APART))(rows)
    return measures.auroc(foreign + where(measures.is_native)(rows))


def _rmse_over_boxes(row: dict) -> float:
    boxes = [row["hidden"].get(f"rmse_{box}_V", np.nan) for box in measures.BOXES]
    return float(row["hidden"]["rmse_V"] / np.min(boxes))


def _closed(row: dict) -> float:
    return 1.0 - row["hidden"]["rmse_V"] / row["hidden"]["rmse_before_V"]


def _held_out(key: str, row: dict) -> float:
    return last_scores(row["said"])[key]


def _rig_sizes_within(rows: Rows) -> dict:
    counts = rig_table(rows).set_index("rig_error").loc["any"]
    return share(counts["within"], counts["told"])


WORDS = replace(
    measures.WORDS,
    numbers=measures.WORDS.numbers
    | {
        "over boxes": _rmse_over_boxes,
        "closed": _closed,
        "held-out χ² before": partial(_held_out, "chi2_per_dof_before"),
        "held-out χ² after": partial(_held_out, "chi2_per_dof_after"),
    },
    measures=measures.WORDS.measures | {"area": _area, "rig sizes within": _rig_sizes_within},
)
# Over all rows: a null that breaks off counts as a false alarm.
NULLS = WORDS.claims("""
nothing left out
  an effect named | null | share named or broken off | ≤ 0.02
  something outside the catalogue flagged | null | share flagged or broken off | ≤ 0.03
""")
SETS = """
{subject}
  F1 of the set, each gap ≥ 8 given the others | {kind}, gap ≥ 8 | F1 | ≥ {f1}
  the whole set right, each gap ≥ 8 given the others | {kind}, gap ≥ 8 | share right
  F1 of the set, all | {kind} | F1
  the whole set right, all | {kind} | share right
  90 % intervals that hold the truth | {kind} | mean coverage
"""
# Over rows of diagnoses that did not break off.
DIAGNOSED = WORDS.claims(
    """
one effect
  right name or declared class, gap ≥ 8 | single, gap ≥ 8 | share right | ≥ 0.93
  right name or declared class, gap 5 to 8 | single, gap 5 to 8 | share right
  right name or declared class, gap 3 to 5 | single, gap 3 to 5 | share right
  right name or declared class, everything drawn | single | share right
  {at}, gap ≥ 8 | single, gap ≥ 8, sited | share sites right | ≥ 0.95
  {at}, of those rightly named | single, gap ≥ 8, sited, right | share sites right
  class declared in full, of several | single, gap ≥ 8, class, right | share class declared
  90 % intervals that hold the truth, gap ≥ 8 | single, gap ≥ 8 | mean coverage | 0.85 to 0.95
""".replace("{at}", "right electrode, drive, measuring pair or channels")
    + SETS.format(kind="pair", subject="two effects", f1=0.9)
    + SETS.format(kind="triple", subject="three effects", f1=0.65)
    + """
outside the catalogue
  flagged, SNR ≥ 8 after the best fit | foreign, SNR ≥ 8 | share flagged | ≥ 0.7
  flagged, everything drawn | foreign | share flagged
  a name of the catalogue all the same | foreign | share named
  a certain name of the catalogue all the same | foreign | share certain
  called explained | foreign | share explained
  falsely flagged: all without it | native | share flagged | ≤ 0.05
  AUROC of other.probability, SNR ≥ 8 after the best fit | all | area
  other.probability: prevalence here | all | share foreign
  other.probability: expected calibration error | all | calibration error | ≤ 0.05
  the same of the prevalence, said of every recording | all | calibration error of a constant
  other.probability: Brier score over that of the prevalence | all | Brier ratio
  other.probability: slope | all | calibration slope
errors of the rig
  size within a factor 1.5, of those that can be told | all | rig sizes within | ≥ 0.9
hidden frames, an effect
  χ²/dof, median | effect | median χ² | ≤ 1.3
  RMSE over that of the better black box (GP, MLP), median | effect | median over boxes | ≤ 0.5
  noise-free values within the 90 % bands, mean | effect | mean within 90 % | 0.8 to 0.97
  misfit closed, median | effect | median closed
held-out frames, an effect
  χ²/dof before, median | effect | median held-out χ² before
  χ²/dof after, median | effect | median held-out χ² after
"""
)
BROKEN = WORDS.claims("""
the run
  trials broken off | all | share broken off
""")
RUN = WORDS.claims("""
the run
  true effects whose gap is not known | all | unknown gaps
  seconds a diagnosis, median | all | median seconds
  seconds a diagnosis, worst | all | largest seconds
  processor seconds a diagnosis, median | all | median processor seconds
  processor seconds a diagnosis, worst | all | largest processor seconds
""")


def diagnoses_summary(rows: Rows) -> pd.DataFrame:
    """Every share and median (`claims.SUMMARY`) of rows that `trial.trial` makes."""
    diagnosed = _diagnosed(rows)
    return summary((rows, NULLS), (diagnosed, DIAGNOSED), (rows, BROKEN), (diagnosed, RUN))


def _diagnosed(rows: Rows) -> Rows:
    return [row for row in rows if not is_broken(row)]


def rig_table(rows: Rows) -> pd.DataFrame:
    """`rig_sizes.table` of trial rows."""
    return rig_sizes.table([size for row in rows for size in row.get("rig_sizes", [])])


def by_rig(rows: Rows) -> pd.DataFrame:
    """Where nothing is left out but what a rig has: one row (RIG) a kind of its errors, in however
    many of a recording's, and one for all; `named`: recordings in which an effect is, `flagged`:
    something outside the catalogue. A recording that breaks off counts as both, for all."""
    errors = [{error["kind"] for error in row.get("rig", [])} for row in rows]
    nulls = [
        (row, kinds)
        for row, kinds in zip(rows, errors, strict=True)
        if row["kind"] == "null" and (kinds or (is_broken(row) and any(errors)))
    ]
    lines = []
    for kind in ("any", *sorted(set().union(*(kinds for _, kinds in nulls)))):
        counted = [row for row, kinds in nulls if kind == "any" or kind in kinds]
        line = {"rig_error": kind, "n": len(counted)}
        for key, condition in (("named", is_named), ("flagged", is_flagged)):
            measured = share_of(is_alarm(condition))(counted)
            line |= interval_of(key, measured) | {key: measured["hits"]}
        lines.append(line)
    return pd.DataFrame(lines, columns=list(RIG))


def diagnoses_scored(rows: Rows) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES` of diagnoses, and a note."""
    diagnosed = _diagnosed(rows)
    effects = measures.effects(diagnosed)
    tables = {
        "summary": diagnoses_summary(rows),
        "effects": measures.by_name(effects),
        "confusion": measures.confusion(effects),
        "other_calibration": measures.reliability(rows),
        "rig": by_rig(rows),
        "rig_sizes": rig_table(diagnosed),
    }
    searched_names = {name for name, e in EFFECTS.items() if not (e.composite or e.last_resort)}
    return tables, f"names never drawn: {', '.join(sorted(searched_names - set(DRAWN))) or 'none'}"


SCORED: dict[str, Callable[[Rows], tuple[dict[str, pd.DataFrame], str]]] = {
    "diagnoses": diagnoses_scored,
    "p-values": p_value_score.scored,
    "queries": partial(prediction_score.scored, "queries"),
    "owners": partial(prediction_score.scored, "owners"),
    "controls": control_score.scored,
}


def summary_page(lines: pd.DataFrame, block: str, size: str, counted: str) -> str:
    """The summary of an open block as a table that says where it comes from."""
    cells = [
        (*measured_cells(line), line["wanted"], {True: "yes", False: "**no**"}.get(line["met"], ""))
        for line in lines.to_dict("records")
    ]
    head = ("recordings", "what", "measured", "95 %", "n", "wanted", "met")
    source = f"`{COMMAND}` with `calibration: {{block: {block}, size: {size}}}`"
    return "\n".join(
        [f"# The block {block}", "", f"{source}: {counted}.", "", *table(head, cells), ""]
    )


def write(folder: Path, block: str, size: str) -> None:
    """Score the trials in folder/trials into folder: summary.md, and the .csv of
    `blocks.tables`."""
    rows, planned = read(folder / "trials", block, size)
    tables, note = SCORED[sort_of(block)](rows)
    for name, lines in tables.items():
        with atomic_path(folder / f"{name}.csv") as path:
            lines.to_csv(path, index=False)
    codes = {row.get("code", "unknown") for row in rows}
    number = f"{len(rows)} of {planned}" if len(rows) < planned else f"{planned}"
    counted = f"{number} {'skins' if sort_of(block) == 'p-values' else 'recordings'}"
    versions = f"{len(codes)} version{'s' * (len(codes) != 1)} of the diagnosis"
    text = summary_page(
        tables["summary"], block, size, f"{counted}, 95 % intervals; {versions}; {note}"
    )
    with atomic_path(folder / "summary.md") as path:
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[1]).name, sys.argv[2])
