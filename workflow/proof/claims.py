"""Claims: which recordings count, what is measured over them, and the values that are wanted."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from proof.intervals import Bounds, mean, median, share

SUMMARY = ("of", "what", "value", "low", "high", "hits", "n", "wanted", "met")
LINE = (
    *("of", "what", "value", "low", "high", "hits", "n", "ceiling"),
    *("gate", "gate_met", "target", "target_met"),
)
Rows = list[dict]


@dataclass(frozen=True)
class Claim:
    """A line of a score.

    subject and quantity: its first two columns; select: which rows count; measure: a measured value
    of these (`intervals`); gate, target: (lowest, highest) value, None where nothing is asked;
    ceiling: the best value that is possible, of the same rows.
    """

    subject: str
    quantity: str
    select: Callable[[Rows], Rows]
    measure: Callable[[Rows], dict]
    gate: Bounds | None = None
    target: Bounds | None = None
    ceiling: Callable[[Rows], float] | None = None


def claims(subject: str, *lines: tuple) -> list[Claim]:
    """Claims about one subject, of what follows it in a Claim."""
    return [Claim(subject, *line) for line in lines]


def at_most(value: float) -> Bounds:
    """Bounds without a lowest value."""
    return -np.inf, value


def at_least(value: float) -> Bounds:
    """Bounds without a highest value."""
    return value, np.inf


def where(*conditions: Callable[[dict], bool]) -> Callable[[Rows], Rows]:
    """Select the rows that meet every condition."""
    return lambda rows: [row for row in rows if all(condition(row) for condition in conditions)]


def share_of(condition: Callable[[dict], bool]) -> Callable[[Rows], dict]:
    """Measure the share of rows that meet a condition."""
    return lambda rows: share(sum(map(bool, map(condition, rows))), len(rows))


def median_of(number: Callable[[dict], float]) -> Callable[[Rows], dict]:
    """Measure the median of one number a row, unknown ones left out."""
    return lambda rows: median(np.array([number(row) for row in rows], float))


def median_over(numbers: Callable[[dict], list[float]]) -> Callable[[Rows], dict]:
    """Measure the median of some numbers a row, over all of them."""
    return lambda rows: median(np.array([value for row in rows for value in numbers(row)], float))


def mean_over(numbers: Callable[[dict], list[float]]) -> Callable[[Rows], dict]:
    """Measure the mean of some numbers a row, over all of them."""
    return lambda rows: mean(np.array([value for row in rows for value in numbers(row)], float))


def summary(*parts: tuple[Rows, list[Claim]]) -> pd.DataFrame:
    """One line (SUMMARY) a claim of each part, over the part's rows: its value beside its gate."""
    lines = []
    for rows, claims in parts:
        for claim in claims:
            measured = claim.measure(claim.select(rows))
            met = is_met(claim.gate, measured["value"])
            wanted = {"wanted": bounds_text(claim.gate), "met": met}
            lines.append({"of": claim.subject, "what": claim.quantity, **measured, **wanted})
    return pd.DataFrame(lines, columns=list(SUMMARY))


def score(rows: Rows, claims: list[Claim]) -> pd.DataFrame:
    """One line (LINE) a claim: its value beside its ceiling, its gate and its target."""
    lines = []
    for claim in claims:
        counted = claim.select(rows)
        line = {"of": claim.subject, "what": claim.quantity, **claim.measure(counted)}
        line["ceiling"] = np.nan if claim.ceiling is None else claim.ceiling(counted)
        for key, bounds in (("gate", claim.gate), ("target", claim.target)):
            line |= {key: bounds_text(bounds), f"{key}_met": is_met(bounds, line["value"])}
        lines.append(line)
    return pd.DataFrame(lines, columns=list(LINE))


def is_met(bounds: Bounds | None, value: float) -> bool | None:
    """Whether a value lies in its bounds; None without bounds or value."""
    if bounds is None or np.isnan(value):
        return None
    return bool(bounds[0] <= value <= bounds[1])


def bounds_text(bounds: Bounds | None) -> str:
    """Bounds in words; nothing where there are none."""
    if bounds is None:
        return ""
    low, high = bounds
    if high == np.inf:
        return f"≥ {low:g}"
    return f"≤ {high:g}" if low == -np.inf else f"{low:g} to {high:g}"
