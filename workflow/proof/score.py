"""`python -m proof.score results/calibration/report full` scores what is there of an open block.

Every share and statistic has its interval and its number of recordings.
"""

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES
from proof import measures, p_value_score, prediction_score, rig_sizes
from proof.blocks import sort_of, trials
from proof.claims import (
    Claim,
    Rows,
    at_least,
    at_most,
    claims,
    mean_over,
    median_of,
    share_of,
    summary,
    where,
)
from proof.intervals import interval_of, share
from proof.markdown import measured_cells, table
from proof.measures import (
    APART,
    has_all_right,
    has_gap,
    hidden,
    is_alarm,
    is_broken,
    is_flagged,
    is_kind,
    is_named,
    is_sited,
)
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


def _foreign_and_native(rows: Rows) -> Rows:
    """Recordings with foreign physics that the best fit leaves, then those without any."""
    return FOREIGN_LEFT(rows) + NATIVE(rows)


def _rmse_over_boxes(row: dict) -> float:
    boxes = [hidden(f"rmse_{box}_V")(row) for box in measures.BOXES]
    return float(row["hidden"]["rmse_V"] / np.min(boxes))


def _closed(row: dict) -> float:
    return 1.0 - row["hidden"]["rmse_V"] / row["hidden"]["rmse_before_V"]


def _held_out(key: str, row: dict) -> float:
    return row["said"]["fit"]["held_out"][key]


def _seconds(key: str, row: dict) -> float:
    return row.get(key, np.nan)


def _rig_sizes_within(rows: Rows) -> dict:
    counts = rig_table(rows).set_index("rig_error").loc["any"]
    return share(counts["within"], counts["told"])


ALL, NULL, SINGLE = where(), where(is_kind("null")), (is_kind("single"), has_gap(APART))
SITED = (*SINGLE, is_sited(*SITES))
NATIVE, FOREIGN = where(measures.is_native), where(measures.is_foreign)
FOREIGN_LEFT = where(measures.is_foreign, measures.has_snr_left(APART))
WITH_EFFECT = where(measures.has_effect)
RIGHT, COVERAGE = share_of(has_all_right), mean_over(measures.coverages)
SITES_RIGHT, FLAGGED = share_of(measures.has_sites_right), share_of(is_flagged)
AT = "right electrode, drive, measuring pair or channels"
CLASS = "right name or declared class, gap"
COVERED = "90 % intervals that hold the truth"
FAR, EACH_FAR = f"gap ≥ {APART:g}", f"each gap ≥ {APART:g} given the others"
SNR_LEFT = f"SNR ≥ {APART:g} after the best fit"
WITHIN = f"size within a factor {rig_sizes.WITHIN:g}, of those that can be told"


def _set_claims(kind: str, subject: str, least_f1: float) -> list[Claim]:
    whole_kind, apart = where(is_kind(kind)), where(is_kind(kind), has_gap(APART))
    return claims(
        subject,
        (f"F1 of the set, {EACH_FAR}", apart, measures.f1, at_least(least_f1)),
        (f"the whole set right, {EACH_FAR}", apart, RIGHT),
        ("F1 of the set, all", whole_kind, measures.f1),
        ("the whole set right, all", whole_kind, RIGHT),
        (COVERED, whole_kind, COVERAGE),
    )


# Over all rows: a null that breaks off counts as a false alarm.
NULLS = claims(
    "nothing left out",
    ("an effect named", NULL, share_of(is_alarm(is_named)), at_most(0.02)),
    (
        "something outside the catalogue flagged",
        *(NULL, share_of(is_alarm(is_flagged)), at_most(0.03)),
    ),
)
# Over rows of diagnoses that did not break off.
DIAGNOSED = [
    *claims(
        "one effect",
        (f"{CLASS} ≥ {APART:g}", where(*SINGLE), RIGHT, at_least(0.93)),
        (f"{CLASS} 5 to 8", where(is_kind("single"), has_gap(5.0, 8.0)), RIGHT),
        (f"{CLASS} 3 to 5", where(is_kind("single"), has_gap(3.0, 5.0)), RIGHT),
        (f"{AT}, {FAR}", where(*SITED), SITES_RIGHT, at_least(0.95)),
        (f"{AT}, of those rightly named", where(*SITED, has_all_right), SITES_RIGHT),
        (
            "class declared in full, of several",
            where(*SINGLE, measures.has_class, has_all_right),
            share_of(measures.has_class_declared),
        ),
        (f"{COVERED}, {FAR}", where(*SINGLE), COVERAGE, (0.85, 0.95)),
    ),
    *_set_claims("pair", "two effects", 0.90),
    *_set_claims("triple", "three effects", 0.65),
    *claims(
        "outside the catalogue",
        (f"flagged, {SNR_LEFT}", FOREIGN_LEFT, FLAGGED, at_least(0.70)),
        ("flagged, all", FOREIGN, FLAGGED),
        ("falsely flagged: all without it", NATIVE, FLAGGED, at_most(0.05)),
        (f"AUROC of other.probability, {SNR_LEFT}", _foreign_and_native, measures.auroc),
        ("other.probability: prevalence here", ALL, share_of(measures.is_foreign)),
        (
            "other.probability: expected calibration error",
            *(ALL, measures.calibration_error, at_most(0.05)),
        ),
        ("other.probability: slope", ALL, measures.calibration_slope),
    ),
    *claims("errors of the rig", (WITHIN, ALL, _rig_sizes_within, at_least(0.90))),
    *claims(
        "hidden frames, an effect",
        ("χ²/dof, median", WITH_EFFECT, median_of(hidden("chi2_per_dof")), at_most(1.3)),
        (
            "RMSE over that of the better black box (GP, MLP), median",
            *(WITH_EFFECT, median_of(_rmse_over_boxes), at_most(0.5)),
        ),
        (
            "noise-free values within the 90 % bands, mean",
            *(WITH_EFFECT, mean_over(lambda row: [row["hidden"]["within_90"]]), (0.80, 0.97)),
        ),
        ("misfit closed, median", WITH_EFFECT, median_of(_closed)),
    ),
    *claims(
        "held-out frames, an effect",
        *(
            (f"χ²/dof {moment}, median", WITH_EFFECT, median_of(partial(_held_out, key)))
            for moment, key in (("before", "chi2_per_dof_before"), ("after", "chi2_per_dof_after"))
        ),
    ),
]
BROKEN = claims("the run", ("trials broken off", ALL, share_of(is_broken)))
RUN = claims(
    "the run",
    ("true effects whose gap is not known", ALL, measures.unknown_gaps),
    ("seconds a diagnosis, median", ALL, median_of(partial(_seconds, "seconds"))),
    ("seconds a diagnosis, worst", ALL, measures.largest("seconds")),
    ("processor seconds a diagnosis, median", ALL, median_of(partial(_seconds, "cpu_seconds"))),
    ("processor seconds a diagnosis, worst", ALL, measures.largest("cpu_seconds")),
)


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
