"""Whether something is left that no name accounts for, and what it looks like."""

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitskin.diagnose.search.gates import NOTHING_UNNAMED
from eitskin.diagnose.verdict.atlas import DISCOVERY

PRIOR = 0.05  # that physics outside the catalogue is present, before looking
# What a Bayes factor's logarithm counts, and the most that it may be: a p-value is no smaller than
# the covariance is true. Of the logistic regression that `calibration.other_probability` makes.
WEIGHT, MOST = 0.82, 5.0
INDEPENDENT = 0.5  # of the atlas's rows: the rest say what others say
LAWS = {
    "time": "time",
    "order": "time",
    "session": "time",
    "dwell": "time",
    "force": "force",
    "touched": "force",
    "probe": "force",
    "touch signal": "force",
    "load direction": "load-direction",
    "position": "position",
    "press": "position",
    "scan": "scan-order",
    "amplitude": "amplitude",
}


@dataclass(frozen=True)
class Other:
    """What is left over: probability that it is more than chance; electrodes, drives, measures
    where it sits; driver and law; a sentence, None below one half; its length in noise units, as
    the row of the atlas has it that has most."""

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
    odds = PRIOR / (1.0 - PRIOR) * np.exp(WEIGHT * min(log_bayes_factor(p_value), MOST))
    return float(odds / (1.0 + odds))


def unlike(likeness: float) -> Other:
    """What is to be said where the readings are not those of a skin like this; likeness: their
    squared correlation with the simulation."""
    against = ", and they run against it" if likeness < 0.0 else ""
    said = (
        f"The readings are not those of such a skin: their squared correlation with the simulation"
        f" is {abs(likeness):.2f}{against}. Order and polarity of the channels, drive and"
        " electrodes are to be checked before anything can be named."
    )
    return Other(probability(0.0), 0.0, [], [], [], None, None, said, np.inf)


def other(atlas: pd.DataFrame, catalogue_p: float) -> Other:
    """What the atlas of the final residual still shows; catalogue_p: the global p-value of the best
    candidate that did not enter."""
    rows = atlas[atlas["statistic"] != "everything"]
    least = float(rows["p"].min()) if len(rows) else 1.0
    count = max(1.0, INDEPENDENT * len(rows))
    p = float(-np.expm1(count * np.log1p(-min(least, 1.0 - 1e-16))))
    p = min(1.0, 2.0 * min(p, catalogue_p))
    chance = probability(p)
    snr = float(np.sqrt(max((rows["value"] - rows["dof"]).max(), 0.0))) if len(rows) else 0.0
    if NOTHING_UNNAMED.admits(chance):
        return Other(chance, p, [], [], [], None, None, None, snr)
    if not len(rows):
        said = "More is left than chance leaves, without a pattern that a test knows."
        return Other(chance, p, [], [], [], None, None, said, snr)
    top = rows.iloc[0]
    statistic, _, where = top["statistic"].partition(": ")
    driver = LAWS.get(statistic, "static")
    located = rows[rows["statistic"].str.contains(": (?:electrode|drive|measuring pair)$")]
    best = located.iloc[0] if len(located) else None
    sites: dict[str, list[int]] = {"electrodes": [], "drives": [], "measures": []}
    if best is not None and best["q"] < DISCOVERY:
        kind = best["statistic"].rpartition(": ")[2]
        number = re.match(r"\d+", best["site"])
        assert number is not None
        first = int(number.group())
        key = {"electrode": "electrodes", "drive": "drives", "measuring pair": "measures"}[kind]
        sites[key] = [first]
    law = {
        "time": "linear in time",
        "force": "linear in force",
        "load-direction": "a step between loading and unloading",
        "position": "by place",
        "scan-order": "along the scan",
        "amplitude": f"{where} of the reading",
        "static": "constant",
    }[driver]
    return Other(chance, p, **sites, driver=driver, law=law, sentence=top["sentence"], snr=snr)
