"""`python -m proof.score results/calibration/report full` scores what is there of a block.

How often a diagnosis is right: false alarms, names, sites and intervals, sets of effects, physics
outside the catalogue, prediction; every share with its interval and its number of recordings.
Blocks of p-values and of queries are scored by `p_value_score` and `query_score`.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.linear_model import LogisticRegression

from eitskin.atomic import atomic_path
from eitskin.diagnose.verdict.verdict import LIKELY
from eitskin.effects import EFFECTS
from proof import judge, owner_score, p_value_score, query_score, rig_sizes
from proof.blocks import sort_of, trials
from proof.intervals import wilson
from proof.lines import SUMMARY, line, median, over, share
from proof.trial import file_of
from witness.strengths import DRAWN

APART = (
    8.0  # gap from which a name has to be found, SNR from which something else has to be noticed
)
BANDS = ((3.0, 5.0), (5.0, APART), (APART, np.inf))
BINS = 10  # of other.probability
COMMAND = "snakemake --cores 2 calibrate_diagnosis"
HIDDEN = ("rmse_V", "rmse_before_V", "rmse_gp_V", "rmse_mlp_V", "chi2_per_dof", "within_90")
RIG = (
    *("rig_error", "n", "named", "named_low", "named_high"),
    *("flagged", "flagged_low", "flagged_high"),
)
EFFECT = (
    *("kind", "seed", "name", "scope", "gap", "class_size", "others_gap", "right", "declared"),
    *("called", "sited", "sites_right", "covered", "intervals"),
)


def read(folder: Path, block: str, size: str) -> tuple[list[dict], int]:
    """The rows of a plan that are there, in its order, `kind` without what the rig adds; and the
    number planned."""
    planned = trials(block, size)
    paths = [file_of(folder, kind, seed) for kind, seed in planned]
    rows = [json.loads(path.read_text("utf-8")) for path in paths if path.exists()]
    return [{**row, "kind": row["kind"].partition("+")[0]} for row in rows], len(planned)


def effects(rows: list[dict]) -> pd.DataFrame:
    """One row (EFFECT) a true effect. gap: to the nearest name outside its class; others_gap: the
    smallest of its recording; called: what it was named; covered of intervals: its parameters, of
    those with the right name."""
    made = []
    for row in rows:
        truth = row.get("truth", [])
        gaps = [judge.next_gap(g) for g in row.get("true_gaps", [])]
        named = judge.matched(row) if truth else []
        for i, (item, found) in enumerate(zip(truth, named, strict=True)):
            listed = row["true_gaps"][i] or []
            said = row["said"]["effects"]
            # A single effect is right where nothing else is said.
            hit = found if len(truth) > 1 or len(said) == 1 else None
            inside: list[bool] = []
            if hit is not None and hit["name"] == item["name"]:
                inside = judge.covered(hit, item, row["scopes"][i])
            sited = row["scopes"][i] == "sparse" and judge.site_kind(item) is not None
            made.append(
                {
                    "kind": row["kind"].partition(":")[0],
                    "seed": row["seed"],
                    "name": item["name"],
                    "scope": row["scopes"][i],
                    "gap": gaps[i],
                    "class_size": 1 + sum(gap < judge.CLASS for _, gap in listed),
                    "others_gap": min(gaps) if not np.isnan(gaps).any() else np.nan,
                    "right": hit is not None,
                    "declared": hit is not None and judge.class_declared(hit, item["name"], listed),
                    "called": _called(said) if hit is None else item["name"],
                    "sited": sited,
                    "sites_right": sited and any(judge.sites_right(f, item) for f in said),
                    "covered": sum(inside),
                    "intervals": len(inside),
                }
            )
    truths = dict.fromkeys(("right", "declared", "sited", "sites_right"), bool)
    return pd.DataFrame(made, columns=list(EFFECT)).astype(truths)


def _called(said: list[dict]) -> str:
    return "nothing" if not said else said[0]["name"] if len(said) == 1 else "several"


def summary(rows: list[dict]) -> pd.DataFrame:
    """Every share and median (SUMMARY) of trial rows, as `trial` makes them."""
    whole = [row for row in rows if "failed" not in row]
    table = effects(whole)
    parts = [
        _nulls(rows),
        _singles(table),
        _sets(whole, table),
        _outside(whole),
        _rig_sizes(whole),
        _hidden(whole),
        _run(rows, whole),
    ]
    return pd.DataFrame([line for part in parts for line in part], columns=list(SUMMARY))


def flagged(row: dict) -> bool:
    return row["said"]["other"]["probability"] >= LIKELY


def _nulls(rows: list[dict]) -> list[dict]:
    """A null that breaks off counts as a false alarm."""
    nulls = [row for row in rows if row["kind"] == "null"]
    named = sum("failed" in row or bool(row["said"]["effects"]) for row in nulls)
    noticed = sum("failed" in row or flagged(row) for row in nulls)
    return [
        share("nothing left out", "an effect named", named, len(nulls), (-np.inf, 0.02)),
        share(
            "nothing left out",
            "something outside the catalogue flagged",
            noticed,
            len(nulls),
            (-np.inf, 0.03),
        ),
    ]


def _singles(table: pd.DataFrame) -> list[dict]:
    alone = table[table["kind"] == "single"]
    of = "one effect"
    lines = []
    for low, high in reversed(BANDS):
        band = alone[(alone["gap"] >= low) & (alone["gap"] < high)]
        text = f"gap ≥ {low:g}" if high == np.inf else f"gap {low:g} to {high:g}"
        wanted = (0.93, np.inf) if low == APART else None
        what = f"right name or declared class, {text}"
        lines.append(share(of, what, band["right"].sum(), len(band), wanted))
    gated = alone[alone["gap"] >= APART]
    sited = gated[gated["sited"]]
    named = sited[sited["right"]]
    classes = gated[(gated["class_size"] > 1) & gated["right"]]
    text = f"gap ≥ {APART:g}"
    at = "right electrode, drive, measuring pair or channels"
    lines += [
        share(of, f"{at}, {text}", sited["sites_right"].sum(), len(sited), (0.95, np.inf)),
        share(of, f"{at}, of those rightly named", named["sites_right"].sum(), len(named)),
        share(of, "class declared in full, of several", classes["declared"].sum(), len(classes)),
        coverage(of, f"90 % intervals that hold the truth, {text}", gated, (0.85, 0.95)),
    ]
    return lines


def coverage(of: str, what: str, table: pd.DataFrame, wanted: tuple | None = None) -> dict:
    """Every rightly named effect weighs the same, however many numbers it has."""
    counted = table[table["intervals"] > 0]
    inside = (counted["covered"] / counted["intervals"]).to_numpy(float)
    return over(of, what, len(inside), lambda index: float(inside[index].mean()), wanted)


def _sets(rows: list[dict], table: pd.DataFrame) -> list[dict]:
    lines = []
    for kind, wanted in (("pair", 0.90), ("triple", 0.65)):
        of = {"pair": "two effects", "triple": "three effects"}[kind]
        own = table[table["kind"] == kind]
        said = {r["seed"]: len(r["said"]["effects"]) for r in rows if r["kind"] == kind}
        for least, text in ((APART, f"each gap ≥ {APART:g} given the others"), (-np.inf, "all")):
            kept = own if least == -np.inf else own[own["others_gap"] >= least]
            grouped = kept.groupby("seed")["right"].agg(["sum", "size"])
            found = np.array([said[seed] for seed in grouped.index])
            goal = (wanted, np.inf) if least == APART else None
            score = f1(grouped["sum"].to_numpy(), grouped["size"].to_numpy(), found)
            lines.append(over(of, f"F1 of the set, {text}", len(grouped), score, goal))
            whole = (grouped["sum"] == grouped["size"]).to_numpy() & (found == grouped["size"])
            lines.append(share(of, f"the whole set right, {text}", whole.sum(), len(grouped)))
        lines.append(coverage(of, "90 % intervals that hold the truth", own))
    return lines


def f1(right: np.ndarray, true: np.ndarray, found: np.ndarray) -> Callable[[np.ndarray], float]:
    """F1 over the effects of all drawn recordings: 2 right / (true + found)."""
    return lambda i: float(2 * right[i].sum() / (true[i].sum() + found[i].sum()))


def auroc(positive: np.ndarray, negative: np.ndarray) -> float:
    """Probability that a positive's score is above a negative's, ties half; NaN without both."""
    if not len(positive) or not len(negative):
        return float("nan")
    above = positive[:, None] > negative
    return float((above + 0.5 * (positive[:, None] == negative)).mean())


def _outside(rows: list[dict]) -> list[dict]:
    of = "outside the catalogue"
    shown = [r for r in rows if r["outside"] and r.get("snr_left", np.nan) >= APART]
    every = [r for r in rows if r["outside"]]
    inside = [r for r in rows if not r["outside"]]
    hit, probability = (
        np.array([f(r) for r in shown + inside], float)
        for f in (lambda r: bool(r["outside"]), lambda r: r["said"]["other"]["probability"])
    )

    def area(index: np.ndarray) -> float:
        there = hit[index] > 0
        return auroc(probability[index][there], probability[index][~there])

    text = f"SNR ≥ {APART:g} after the best fit"
    false = sum(map(flagged, inside))
    return [
        share(of, f"flagged, {text}", sum(map(flagged, shown)), len(shown), (0.70, np.inf)),
        share(of, "flagged, all", sum(map(flagged, every)), len(every)),
        share(of, "falsely flagged: all without it", false, len(inside), (-np.inf, 0.05)),
        over(of, f"AUROC of other.probability, {text}", len(hit), area),
        *_calibrated(of, rows),
    ]


def _calibrated(of: str, rows: list[dict]) -> list[dict]:
    """Lines on other.probability as a probability: expected calibration error over BINS, slope of
    the logistic regression on its logit, and how often there was something."""
    said, there = _said_and_there(rows)
    logit = np.log(said / (1.0 - said))[:, None]

    def error(index: np.ndarray) -> float:
        own = _bin(said[index])
        off = np.bincount(own, said[index] - there[index], BINS)
        return float(np.abs(off).sum() / len(index))

    def slope(index: np.ndarray) -> float:
        if len(np.unique(there[index])) < 2:
            return float("nan")
        found = LogisticRegression(C=np.inf).fit(logit[index], there[index])
        return float(found.coef_[0, 0])

    name = "other.probability"
    return [
        share(of, f"{name}: prevalence here", there.sum(), len(there)),
        over(of, f"{name}: expected calibration error", len(there), error, (-np.inf, 0.05)),
        over(of, f"{name}: slope", len(there), slope),
    ]


def _said_and_there(rows: list[dict]) -> tuple[np.ndarray, np.ndarray]:
    """other.probability (n,), and whether there was physics outside the catalogue (n,)."""
    rows = [row for row in rows if "failed" not in row]
    said = np.array([r["said"]["other"]["probability"] for r in rows], float)
    return said, np.array([bool(r["outside"]) for r in rows], bool)


def _bin(probability: np.ndarray) -> np.ndarray:
    return np.minimum((probability * BINS).astype(int), BINS - 1)


def reliability(rows: list[dict]) -> pd.DataFrame:
    """Bins of other.probability: low, high, n, its mean, share of recordings with physics outside
    the catalogue, and that share's interval."""
    said, there = _said_and_there(rows)
    which = _bin(said)
    lines = []
    for i in range(BINS):
        own = which == i
        n, hits = int(own.sum()), int(there[own].sum())
        low, high = wilson(hits, n)
        ends = {"from": i / BINS, "to": (i + 1) / BINS, "n": n}
        mean = said[own].mean() if n else np.nan
        share = hits / n if n else np.nan
        lines.append({**ends, "probability": mean, "share": share, "low": low, "high": high})
    return pd.DataFrame(lines)


def _rig_sizes(rows: list[dict]) -> list[dict]:
    whole = rig_table(rows).set_index("rig_error").loc["any"]
    what = f"size within a factor {rig_sizes.WITHIN:g}, of those that can be told"
    return [share("errors of the rig", what, whole["within"], whole["told"], (0.90, np.inf))]


def rig_table(rows: list[dict]) -> pd.DataFrame:
    """`rig_sizes.table` of trial rows."""
    return rig_sizes.table([one for row in rows for one in row.get("rig_sizes", [])])


def _hidden(rows: list[dict]) -> list[dict]:
    of = "hidden frames, an effect"
    own = [row for row in rows if row["truth"]]
    hidden = pd.DataFrame([row["hidden"] for row in own], columns=list(HIDDEN), dtype=float)
    boxes = hidden[["rmse_gp_V", "rmse_mlp_V"]].min(axis=1)
    both = hidden[["rmse_gp_V", "rmse_mlp_V"]].notna().all(axis=1)
    ratio = (hidden["rmse_V"] / boxes)[both].to_numpy()
    closed = 1.0 - (hidden["rmse_V"] / hidden["rmse_before_V"]).to_numpy()
    within = hidden["within_90"].to_numpy()
    chi2 = hidden["chi2_per_dof"].to_numpy()
    fits = [row["said"]["fit"]["held_out"] for row in own]
    before, after = (np.array([f[f"chi2_per_dof_{k}"] for f in fits]) for k in ("before", "after"))
    n = len(own)
    lines = [
        over(of, "χ²/dof, median", n, median(chi2), (-np.inf, 1.3)),
        over(
            of,
            "RMSE over that of the better black box (GP, MLP), median",
            len(ratio),
            median(ratio),
            (-np.inf, 0.5),
        ),
        over(
            of,
            "noise-free values within the 90 % bands, mean",
            n,
            lambda i: float(within[i].mean()),
            (0.80, 0.97),
        ),
        over(of, "misfit closed, median", n, median(closed)),
        over("held-out frames, an effect", "χ²/dof before, median", n, median(before)),
        over("held-out frames, an effect", "χ²/dof after, median", n, median(after)),
    ]
    return lines


def _run(rows: list[dict], whole: list[dict]) -> list[dict]:
    lines = [share("the run", "trials broken off", len(rows) - len(whole), len(rows))]
    unknown = sum(np.isnan(judge.next_gap(g)) for row in whole for g in row["true_gaps"])
    of_all = sum(len(row["true_gaps"]) for row in whole)
    lines.append(share("the run", "true effects whose gap is not known", unknown, of_all))
    for key, text in (("seconds", "seconds"), ("cpu_seconds", "processor seconds")):
        took = np.array([row[key] for row in whole if key in row])
        what = f"{text} a diagnosis"
        lines.append(over("the run", f"{what}, median", len(took), median(took)))
        worst = took.max() if len(took) else np.nan
        lines.append(line("the run", f"{what}, worst", worst, np.nan, np.nan, len(took), None))
    return lines


def by_name(table: pd.DataFrame) -> pd.DataFrame:
    """Counts for every name: alone (all, and at a gap of APART), its sites and intervals there, and
    in sets."""
    alone, sets = table[table["kind"] == "single"], table[table["kind"] != "single"]
    gated = alone[alone["gap"] >= APART]
    lines = []
    for name in sorted(table["name"].unique()):
        one, apart = alone[alone["name"] == name], gated[gated["name"] == name]
        among, sited = sets[sets["name"] == name], apart[apart["sited"]]
        lines.append(
            {
                "name": name,
                "alone": len(one),
                "alone_right": int(one["right"].sum()),
                "gap_median": one["gap"].median(),
                "apart": len(apart),
                "apart_right": int(apart["right"].sum()),
                "sited": len(sited),
                "sites_right": int(sited["sites_right"].sum()),
                "intervals": int(apart["intervals"].sum()),
                "covered": int(apart["covered"].sum()),
                "in_sets": len(among),
                "in_sets_right": int(among["right"].sum()),
            }
        )
    return pd.DataFrame(lines)


def confusion(table: pd.DataFrame) -> pd.DataFrame:
    """Single effects: truth, called (its own name where that or the declared class is right,
    another name, several, nothing), recordings, and those at a gap of APART or more."""
    alone = table[table["kind"] == "single"].assign(apart=lambda t: t["gap"] >= APART)
    grouped = alone.groupby(["name", "called"])["apart"].agg(["size", "sum"]).reset_index()
    grouped.columns = ["truth", "called", "recordings", "apart"]
    return grouped


def by_rig(rows: list[dict]) -> pd.DataFrame:
    """Where nothing is left out but what a rig has: one row (RIG) a kind of its errors, in however
    many of a recording's, and one for all; `named`: recordings in which an effect is, `flagged`:
    something outside the catalogue. A recording that breaks off counts as both, for all."""
    of = [{error["kind"] for error in row.get("rig", [])} for row in rows]
    nulls = [
        (row, kinds)
        for row, kinds in zip(rows, of, strict=True)
        if row["kind"] == "null" and (kinds or ("failed" in row and any(of)))
    ]
    made = []
    for kind in ("any", *sorted(set().union(*(kinds for _, kinds in nulls)))):
        own = [row for row, kinds in nulls if kind == "any" or kind in kinds]
        counted = {
            "named": sum("failed" in row or bool(row["said"]["effects"]) for row in own),
            "flagged": sum("failed" in row or flagged(row) for row in own),
        }
        line = {"rig_error": kind, "n": len(own), **counted}
        for what, hits in counted.items():
            line[f"{what}_low"], line[f"{what}_high"] = wilson(hits, len(own))
        made.append(line)
    return pd.DataFrame(made, columns=list(RIG))


def markdown(
    lines: pd.DataFrame, rows: list[dict], planned: int, block: str, size: str, note: str
) -> str:
    """The summary as a table that says where it comes from, and a note."""
    versions = {row.get("code", "unknown") for row in rows}
    of = f"{len(rows)} of {planned}" if len(rows) < planned else f"{planned}"
    what = "skins" if sort_of(block) == "p-values" else "recordings"
    head = [
        f"# The block {block}",
        "",
        f"`{COMMAND}` with `calibration: {{block: {block}, size: {size}}}`: {of} {what},"
        f" 95 % intervals; {len(versions)} version{'s' * (len(versions) != 1)} of the diagnosis;"
        f" {note}.",
        "",
        "| recordings | what | measured | 95 % | n | wanted | met |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in lines.to_dict("records"):
        counted = one["hits"] is not None and not np.isnan(one["hits"])
        said = number(one["value"], counted)
        ends = [number(one[end], counted) for end in ("low", "high")]
        between = " to ".join(ends) if all(ends) else ""
        met = {True: "yes", False: "**no**"}.get(one["met"], "")
        cells = (one["of"], one["what"], said, between, one["n"], one["wanted"], met)
        head.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(head) + "\n"


def number(value: float, share: bool) -> str:
    if np.isnan(value):
        return ""
    return f"{100 * value:.1f} %" if share else f"{value:.3g}"


def write(folder: Path, block: str, size: str) -> None:
    """Score the trials in folder/trials into folder: summary.md, and the .csv of
    `blocks.tables`."""
    rows, planned = read(folder / "trials", block, size)
    made, note = SCORED[sort_of(block)](rows)
    for name, table in made.items():
        with atomic_path(folder / f"{name}.csv") as path:
            table.to_csv(path, index=False)
    with atomic_path(folder / "summary.md") as path:
        path.write_text(markdown(made["summary"], rows, planned, block, size, note), "utf-8")


def scored(rows: list[dict]) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES` of diagnoses, and a note."""
    whole = [row for row in rows if "failed" not in row]
    table = effects(whole)
    made = {
        "summary": summary(rows),
        "effects": by_name(table),
        "confusion": confusion(table),
        "other_calibration": reliability(rows),
        "rig": by_rig(rows),
        "rig_sizes": rig_table(whole),
    }
    sought = (n for n, e in EFFECTS.items() if not (e.composite or e.last_resort))
    never = sorted(set(sought) - set(DRAWN))
    return made, f"names never drawn: {', '.join(never) or 'none'}"


SCORED: dict[str, Callable[[list[dict]], tuple[dict[str, pd.DataFrame], str]]] = {
    "diagnoses": scored,
    "p-values": p_value_score.scored,
    "queries": query_score.scored,
    "owners": owner_score.scored,
}


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[1]).name, sys.argv[2])
