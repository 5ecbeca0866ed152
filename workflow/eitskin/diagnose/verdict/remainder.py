"""Whether something remains that no name accounts for, and what it looks like."""

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.diagnose.search.gates import NOTHING_UNNAMED
from eitskin.diagnose.verdict.atlas import DISCOVERY
from eitskin.diagnose.verdict.passing import discovered, is_passing

NO_PATTERN = "More is left than chance leaves, and no pattern in it points to a cause."
PRIOR = 0.05  # that physics outside the catalogue is present, before looking
# What a Bayes factor's logarithm counts, and the largest that it may be: a p-value is no smaller
# than the covariance is true. Of the logistic regression that `proof.other_probability` makes.
WEIGHT, LARGEST_LOG_FACTOR = 0.82, 5.0
DRIVERS = {  # of the statistics of the atlas
    "dwell": "time",
    "force": "force",
    "touched": "force",
    "probe": "force",
    "touch signal": "force",
    "load direction": "load-direction",
    "position": "position",
    "scan": "scan-order",
    "amplitude": "amplitude",
}


@dataclass(frozen=True)
class Remainder:
    """What an explanation leaves: probability that it is more than chance; electrodes, drives,
    measures where it sits; driver and law; a sentence, None below one half; its length in noise
    units, by the row of the atlas with the largest."""

    probability: float
    p_value: float
    electrodes: list[int]
    drives: list[int]
    measures: list[int]
    driver: str | None
    law: str | None
    sentence: str | None
    snr: float


def log_bayes_factor(p_value: float) -> float:
    """The largest that a p-value can stand for, -1 / (e p ln p) (Sellke, Bayarri, Berger 2001)."""
    p = min(max(p_value, 1e-300), 1.0)
    return 0.0 if p >= np.exp(-1) else float(-1.0 - np.log(p) - np.log(-np.log(p)))


def probability(p_value: float) -> float:
    """Of physics outside the catalogue: what a p-value has been worth, on the prior odds."""
    odds = (
        PRIOR / (1.0 - PRIOR) * np.exp(WEIGHT * min(log_bayes_factor(p_value), LARGEST_LOG_FACTOR))
    )
    return float(odds / (1.0 + odds))


def unlike_remainder(likeness: float) -> Remainder:
    """The remainder of readings that are not those of a skin like this; likeness: their squared
    correlation with the simulation."""
    against = ", and they run against it" if likeness < 0.0 else ""
    sentence = (
        f"The readings are not those of such a skin: their squared correlation with the simulation"
        f" is {abs(likeness):.2f}{against}. Order and polarity of the channels, drive and"
        " electrodes are to be checked before anything can be named."
    )
    return Remainder(probability(0.0), 0.0, [], [], [], None, None, sentence, np.inf)


def changes(atlas: pd.DataFrame) -> list[str]:
    """Sentences on what changes with time alone, or in one press alone, without a name."""
    return discovered(atlas)["sentence"].tolist()


def remainder(atlas: pd.DataFrame) -> Remainder:
    """What the atlas of the final residual shows.

    The p-value of a row is the larger of that by the covariance and that without. The p-value of
    the remainder is that of the least one of the atlas's n rows but those on what passes,
    1 - (1 - p)^n: rows overlap, so that it is no less (Šidák 1967).
    """
    decisive = atlas[(atlas["statistic"] != "everything") & ~is_passing(atlas)]
    rows = decisive.assign(p=np.maximum(decisive["p"], decisive["free_p"]))
    rows = rows.sort_values("p", kind="stable")
    smallest_p = float(rows["p"].min()) if len(rows) else 1.0
    p = float(-np.expm1(max(len(rows), 1) * np.log1p(-min(smallest_p, 1.0 - 1e-16))))
    chance = probability(p)
    snr = float(np.sqrt(max((rows["value"] - rows["dof"]).max(), 0.0))) if len(rows) else 0.0
    if NOTHING_UNNAMED.admits(chance):
        return Remainder(chance, p, [], [], [], None, None, None, snr)
    top = rows.iloc[0]
    located = decisive[decisive["statistic"].str.contains(": (?:electrode|drive|measuring pair)$")]
    best = located.iloc[0] if len(located) else None
    sites: dict[str, list[int]] = {"electrodes": [], "drives": [], "measures": []}
    if best is not None and best["q"] < DISCOVERY:
        kind = best["statistic"].rpartition(": ")[2]
        number = re.match(r"\d+", best["site"])
        assert number is not None
        key = {"electrode": "electrodes", "drive": "drives", "measuring pair": "measures"}[kind]
        sites[key] = [int(number.group())]
    if top["q"] > DISCOVERY:
        return Remainder(chance, p, **sites, driver=None, law=None, sentence=NO_PATTERN, snr=snr)
    statistic, _, field = top["statistic"].partition(": ")
    driver = DRIVERS.get(statistic, "static")
    law = {
        "time": "linear in time",
        "force": "linear in force",
        "load-direction": "a step between loading and unloading",
        "position": "by place",
        "scan-order": "along the scan",
        "amplitude": f"{field} of the reading",
        "static": "constant",
    }[driver]
    return Remainder(chance, p, **sites, driver=driver, law=law, sentence=top["sentence"], snr=snr)
