"""What rows of recordings with known truth are worth: conditions, numbers and measures of a row.

A row is a recording: {kind, seed, truth, scopes, true_gaps, outside, said, hidden}, the truth
beside what a diagnosis said of it (`trial`, `opened`). {failed: why} where that broke off.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy.stats import norm
from sklearn.linear_model import LogisticRegression

from eitskin.diagnose.search.gates import NOTHING_UNNAMED
from eitskin.effects import EFFECTS
from eitskin.effects.effect import SITES, LeakEffect
from proof import judge
from proof.claims import Condition, Rows, Words, where
from proof.intervals import resampled, share, wilson

APART = 8.0  # gap or SNR at which the best test between two names errs once in 30,000, Φ(-4)
SHOWN = 5.0  # gap from which an effect has to be noticed
BINS = 10  # of other.probability, for its expected calibration error (Guo et al. 2017)
WIDTH_90 = 2 * norm.isf(0.05)  # of an interval of 90 %, in standard deviations
BOXES = ("gp", "mlp")
EFFECT = (
    *("kind", "seed", "name", "scope", "gap", "class_size", "others_gap", "right", "declared"),
    *("called", "sited", "sites_right", "covered", "intervals"),
)


# Conditions of a row.


def is_kind(*kinds: str) -> Condition:
    """Whether a row is of one of the kinds, whatever follows a colon in it."""
    return lambda row: row["kind"].partition(":")[0] in kinds


def has_gap(low: float, high: float = np.inf) -> Condition:
    """Whether a row's smallest gap is `low` or more, and below `high`."""
    return lambda row: low <= smallest_gap(row) < high or smallest_gap(row) == high


def has_snr_left(low: float, high: float = np.inf) -> Condition:
    """Whether the best fit leaves so much of the truth, in noise units."""
    return lambda row: low <= row.get("snr_left", np.nan) <= high


def is_sited(*kinds: str) -> Condition:
    """Whether a row's first true effect sits at sites of one of the kinds."""
    return lambda row: row["scopes"][0] == "sparse" and judge.site_kind(row["truth"][0]) in kinds


def is_broken(row: dict) -> bool:
    """Whether the diagnosis broke off."""
    return "failed" in row


def is_foreign(row: dict) -> bool:
    """Whether physics is in the recording that the catalogue has not."""
    return bool(row["outside"])


def is_native(row: dict) -> bool:
    """Whether all that is in the recording is the catalogue's."""
    return not is_foreign(row)


def has_effect(row: dict) -> bool:
    """Whether an effect of the catalogue is in the recording, and nothing foreign."""
    return bool(row["truth"]) and is_native(row)


def is_named(row: dict) -> bool:
    """Whether the diagnosis names an effect."""
    return bool(row["said"]["effects"])


def is_flagged(row: dict) -> bool:
    """Whether the diagnosis says that something outside the catalogue is likely."""
    return row["said"]["other"]["probability"] >= NOTHING_UNNAMED.threshold


def is_certain(row: dict) -> bool:
    """Whether the diagnosis names an effect as certain."""
    return any(entry["certain"] for entry in row["said"]["effects"])


def is_explained(row: dict) -> bool:
    """Whether the diagnosis says that what it names explains the misfit."""
    return row["said"]["verdict"] == "explained"


def is_noticed(row: dict) -> bool:
    """Whether a diagnosis says that something is left out, with a name or without."""
    return is_named(row) or is_flagged(row)


def is_alarm(condition: Condition) -> Condition:
    """Whether a condition is met or the diagnosis broke off."""
    return lambda row: is_broken(row) or condition(row)


def has_all_right(row: dict) -> bool:
    """Whether all true effects are named, and nothing else."""
    return right_names(row) == len(row["truth"]) == len(row["said"]["effects"])


def has_class_declared(row: dict) -> bool:
    """Whether a single effect's entry declares its whole class."""
    (entry,) = row["said"]["effects"]
    return judge.class_declared(entry, row["truth"][0]["name"], row["true_gaps"][0] or [])


def has_sites_right(row: dict) -> bool:
    """Whether any entry sits at the sites of the first true effect, and nowhere else."""
    return any(judge.sites_right(entry, row["truth"][0]) for entry in row["said"]["effects"])


def has_side_right(row: dict) -> bool:
    """Whether all entries are on the side of the first true effect, instrument or skin."""
    sides = {side(entry["name"]) for entry in row["said"]["effects"]}
    return sides <= {side(row["truth"][0]["name"])}


def has_decoy_named(row: dict) -> bool:
    """Whether the name is given that a decoy only looks like."""
    return any(entry["name"] == row["absent"] for entry in row["said"]["effects"])


def has_class(row: dict) -> bool:
    """Whether the first true effect's class holds another name."""
    return class_size(row["true_gaps"][0]) > 1


# Numbers of a row.


def smallest_gap(row: dict) -> float:
    """The smallest gap of a row's effects to a name outside their class; NaN where one is unknown,
    or where there is none."""
    return float(np.min([judge.next_gap(gaps) for gaps in row["true_gaps"]] or [np.nan]))


def right_names(row: dict) -> int:
    """Number of true effects that are rightly named."""
    return sum(entry is not None for entry in judge.matched(row))


def class_size(gaps: list | None) -> int:
    """Number of names in a true effect's class."""
    return 1 + sum(gap < judge.CLASS for _, gap in gaps or [])


def hits(row: dict) -> list[dict | None]:
    """For each true effect the entry that names it; a single effect is right only where nothing
    else is named."""
    entries = judge.matched(row)
    return (
        entries if len(entries) > 1 or len(row["said"]["effects"]) == 1 else [None] * len(entries)
    )


def coverages(row: dict) -> list[float]:
    """Of each true effect with the right name: the share of its numbers that lie in their
    intervals. Every effect weighs the same, however many numbers it has."""
    shares = []
    for true_effect, scope, hit in zip(row["truth"], row["scopes"], hits(row), strict=True):
        if hit is not None and hit["name"] == true_effect["name"]:
            inside = judge.covered(hit, true_effect, scope)
            shares += [sum(inside) / len(inside)] if inside else []
    return shares


def errors(row: dict) -> list[float]:
    """Of each rightly named effect: the median over its numbers of |error| over the Cramér-Rao
    bound's standard deviation, which the oracle's intervals show."""
    if row["best"] is None:
        return []
    medians = []
    for true_effect, scope, entry, best in zip(
        row["truth"], row["scopes"], judge.matched(row), row["best"], strict=True
    ):
        if entry is None or entry["name"] != true_effect["name"]:
            continue
        width = {(n.key, n.place): n.high - n.low for n in judge.numbers(best, true_effect, scope)}
        ratios = [
            abs(n.value - n.true) * WIDTH_90 / width[n.key, n.place]
            for n in judge.numbers(entry, true_effect, scope)
            if width.get((n.key, n.place), 0.0) > 0
        ]
        if ratios:
            medians.append(float(np.median(np.nan_to_num(ratios, nan=np.inf))))
    return medians


def hidden(key: str) -> Callable[[dict], float]:
    """A number of what was predicted of hidden frames."""
    return lambda row: row["hidden"].get(key, np.nan)


def misfit_closed(row: dict, method: str = "eitskin") -> float:
    """(RMSE before - RMSE) / (RMSE before - RMSE of the oracle) on hidden frames; NaN where the
    oracle is no better than the owner's belief."""
    rmse = row["hidden"]
    possible = rmse["none"] - rmse["oracle"]
    return (rmse["none"] - rmse[method]) / possible if possible > 0 else float("nan")


def boxes_over_ours(row: dict) -> float:
    """How many times larger the better black box's RMSE on hidden frames is."""
    return min(row["hidden"][box] for box in BOXES) / row["hidden"]["eitskin"]


def side(name: str) -> str:
    """instrument (wires, readings, scan) or skin (touches and all that they press)."""
    effect = EFFECTS[name]
    if isinstance(effect, LeakEffect) and effect.on_contact:
        return "skin"
    return "instrument" if effect.stage in ("wiring", "instrument", "clock") else "skin"


# Measures of many rows.


def f1(rows: Rows) -> dict:
    """F1 over the effects of all recordings: 2 right / (true + named)."""
    right_count = np.array([right_names(row) for row in rows])
    true = np.array([len(row["truth"]) for row in rows])
    named = np.array([len(row["said"]["effects"]) for row in rows])
    return resampled(
        len(rows), lambda i: float(2 * right_count[i].sum() / (true[i].sum() + named[i].sum()))
    )


def ceiling(rows: Rows) -> float:
    """Φ(gap / 2), the accuracy of the best test between two names, in the mean."""
    return float(norm.cdf(0.5 * np.array(list(map(smallest_gap, rows)))).mean()) if rows else np.nan


def stated_probability(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """other.probability (n,), and whether there was physics outside the catalogue (n,)."""
    probability = np.array([row["said"]["other"]["probability"] for row in rows], float)
    return probability, np.array(list(map(is_foreign, rows)), bool)


def auroc(rows: Rows) -> dict:
    """Probability that other.probability is larger where physics is foreign than where none is,
    ties half; NaN without both."""
    probability, foreign = stated_probability(rows)

    def area(index: np.ndarray) -> float:
        positive, negative = (probability[index][foreign[index] == kind] for kind in (True, False))
        if not len(positive) or not len(negative):
            return float("nan")
        above = positive[:, None] > negative
        return float((above + 0.5 * (positive[:, None] == negative)).mean())

    return resampled(len(rows), area)


def calibration_error(rows: Rows) -> dict:
    """Expected calibration error of other.probability over BINS."""
    probability, foreign = stated_probability(rows)

    def error(index: np.ndarray) -> float:
        excess = probability[index] - foreign[index]
        excess_sums = np.bincount(_bin(probability[index]), excess, BINS)
        return float(np.abs(excess_sums).sum() / len(index))

    return resampled(len(rows), error)


def constant_calibration_error(rows: Rows) -> dict:
    """Expected calibration error of a probability that is the same for every recording, the
    prevalence in `rows`; over recordings drawn anew that differs from theirs."""
    _, foreign = stated_probability(rows)
    return resampled(len(rows), lambda index: float(abs(foreign.mean() - foreign[index].mean())))


def brier_ratio(rows: Rows) -> dict:
    """Brier's score of other.probability over that of the prevalence, said of every recording: 1
    where it tells nothing, 0 where it tells all."""
    probability, foreign = stated_probability(rows)

    def ratio(index: np.ndarray) -> float:
        error = ((probability[index] - foreign[index]) ** 2).mean()
        return float(error / foreign[index].var()) if foreign[index].var() > 0 else float("nan")

    return resampled(len(rows), ratio)


def calibration_slope(rows: Rows) -> dict:
    """Slope of the logistic regression of what is foreign on other.probability's logit (Cox
    1958)."""
    probability, foreign = stated_probability(rows)
    logit = np.log(probability / (1.0 - probability))[:, None]

    def slope(index: np.ndarray) -> float:
        if len(np.unique(foreign[index])) < 2:
            return float("nan")
        regression = LogisticRegression(C=np.inf).fit(logit[index], foreign[index])
        return float(regression.coef_[0, 0])

    return resampled(len(rows), slope)


def _bin(probability: np.ndarray) -> np.ndarray:
    return np.minimum((probability * BINS).astype(int), BINS - 1)


def unknown_gaps(rows: Rows) -> dict:
    """Share of true effects whose gap is not known."""
    gaps = [judge.next_gap(gaps) for row in rows for gaps in row["true_gaps"]]
    return share(int(np.isnan(gaps).sum()), len(gaps))


# Tables.


def effects(rows: Rows) -> pd.DataFrame:
    """One row (EFFECT) a true effect. gap: to the nearest name outside its class; others_gap: the
    smallest of its recording; called: what it was named; covered of intervals: its parameters, of
    those with the right name."""
    lines = []
    for row in rows:
        entries = row["said"]["effects"]
        for i, (true_effect, hit) in enumerate(zip(row["truth"], hits(row), strict=True)):
            gaps, scope = row["true_gaps"][i] or [], row["scopes"][i]
            name, inside = true_effect["name"], []
            if hit is not None and hit["name"] == name:
                inside = judge.covered(hit, true_effect, scope)
            sited = scope == "sparse" and judge.site_kind(true_effect) is not None
            lines.append(
                {
                    "kind": row["kind"].partition(":")[0],
                    "seed": row["seed"],
                    "name": name,
                    "scope": scope,
                    "gap": judge.next_gap(row["true_gaps"][i]),
                    "class_size": class_size(gaps),
                    "others_gap": smallest_gap(row),
                    "right": hit is not None,
                    "declared": hit is not None and judge.class_declared(hit, name, gaps),
                    "called": _called(entries) if hit is None else name,
                    "sited": sited,
                    "sites_right": sited
                    and any(judge.sites_right(e, true_effect) for e in entries),
                    "covered": sum(inside),
                    "intervals": len(inside),
                }
            )
    booleans = dict.fromkeys(("right", "declared", "sited", "sites_right"), bool)
    return pd.DataFrame(lines, columns=list(EFFECT)).astype(booleans)


def _called(entries: list[dict]) -> str:
    return "nothing" if not entries else entries[0]["name"] if len(entries) == 1 else "several"


def by_name(table: pd.DataFrame) -> pd.DataFrame:
    """Counts for every name of a table of effects: alone (all, and at a gap of APART), its sites
    and intervals there, and in sets."""
    single, sets = table[table["kind"] == "single"], table[table["kind"] != "single"]
    lines = []
    for name in sorted(table["name"].unique()):
        alone, in_sets = (part[part["name"] == name] for part in (single, sets))
        apart = alone[alone["gap"] >= APART]
        sited = apart[apart["sited"]]
        lines.append(
            {
                "name": name,
                "alone": len(alone),
                "alone_right": int(alone["right"].sum()),
                "gap_median": alone["gap"].median(),
                "apart": len(apart),
                "apart_right": int(apart["right"].sum()),
                "sited": len(sited),
                "sites_right": int(sited["sites_right"].sum()),
                "intervals": int(apart["intervals"].sum()),
                "covered": int(apart["covered"].sum()),
                "in_sets": len(in_sets),
                "in_sets_right": int(in_sets["right"].sum()),
            }
        )
    return pd.DataFrame(lines)


def confusion(table: pd.DataFrame) -> pd.DataFrame:
    """Single effects: truth, called (its own name where that or the declared class is right,
    another name, several, nothing), recordings, and those at a gap of APART or more."""
    single = table[table["kind"] == "single"].assign(apart=lambda t: t["gap"] >= APART)
    counts = single.groupby(["name", "called"])["apart"].agg(["size", "sum"]).reset_index()
    counts.columns = ["truth", "called", "recordings", "apart"]
    return counts


def reliability(rows: Rows) -> pd.DataFrame:
    """Bins of other.probability: from, to, n, its mean, share of recordings with physics outside
    the catalogue, and that share's interval. Real recordings do not count: nobody knows what is in
    them."""
    counted = where(lambda row: not is_broken(row) and row["kind"] != "real")(rows)
    probability, foreign = stated_probability(counted)
    label = _bin(probability)
    lines = []
    for i in range(BINS):
        inside = label == i
        n, hits = int(inside.sum()), int(foreign[inside].sum())
        low, high = wilson(hits, n)
        ends = {"from": i / BINS, "to": (i + 1) / BINS, "n": n}
        mean = probability[inside].mean() if n else np.nan
        fraction = hits / n if n else np.nan
        lines.append({**ends, "probability": mean, "share": fraction, "low": low, "high": high})
    return pd.DataFrame(lines)


WORDS = Words(
    conditions={
        **{kind: is_kind(kind) for kind in ("null", "single", "pair", "triple", "decoy", "real")},
        "pair or triple": is_kind("pair", "triple"),
        "effect": has_effect,
        "foreign": is_foreign,
        "native": is_native,
        "sited": is_sited(*SITES),
        "at electrodes": is_sited("electrodes"),
        "class": has_class,
        "named": is_named,
        "flagged": is_flagged,
        "noticed": is_noticed,
        "certain": is_certain,
        "explained": is_explained,
        "broken off": is_broken,
        "named or broken off": is_alarm(is_named),
        "flagged or broken off": is_alarm(is_flagged),
        "noticed or broken off": is_alarm(is_noticed),
        "decoy named or broken off": is_alarm(has_decoy_named),
        "right": has_all_right,
        "class declared": has_class_declared,
        "sites right": has_sites_right,
        "side right": has_side_right,
    },
    numbers={
        "coverage": coverages,
        "error": errors,
        "misfit closed": misfit_closed,
        "boxes": boxes_over_ours,
        "χ²": hidden("chi2_per_dof"),
        "within 90 %": hidden("within_90"),
        "seconds": lambda row: row.get("seconds", np.nan),
        "processor seconds": lambda row: row.get("cpu_seconds", np.nan),
    },
    measures={
        "F1": f1,
        "AUROC": auroc,
        "calibration error": calibration_error,
        "calibration error of a constant": constant_calibration_error,
        "Brier ratio": brier_ratio,
        "calibration slope": calibration_slope,
        "unknown gaps": unknown_gaps,
    },
    ceilings={"Φ": ceiling},
    bands={"gap": has_gap, "SNR": has_snr_left},
)
