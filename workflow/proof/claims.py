"""Claims: which recordings count, what is measured over them, and the values that are wanted.

They are read from a table, a claim a line below its subject:

    one effect
      right name, gap ≥ 8 | single, gap ≥ 8 | share right | ≥ 0.95 | ≥ 0.98 | Φ

quantity, rows that count, measure, gate, target and ceiling, the last three as far as there are
any. Rows: conditions that all are met, "all" for every row. Measure: "share" of a condition,
"median", "mean" or "largest" of a number, or one by its name.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from proof.intervals import Bounds, mean, median, point, share

SUMMARY = ("of", "what", "value", "low", "high", "hits", "n", "wanted", "met")
LINE = (
    *("of", "what", "value", "low", "high", "hits", "n", "ceiling"),
    *("gate", "gate_met", "target", "target_met"),
)
Rows = list[dict]
Condition = Callable[[dict], bool]
Measure = Callable[[Rows], dict]
Number = Callable[[dict], float | list[float]]


@dataclass(frozen=True)
class Claim:
    """A line of a score.

    subject and quantity: its first two columns; conditions: which rows count; measure: a measured
    value of these (`intervals`); gate, target: (lowest, highest) value, None where nothing is
    asked; ceiling: the best value that is possible, of the same rows.
    """

    subject: str
    quantity: str
    conditions: tuple[Condition, ...]
    measure: Measure
    gate: Bounds | None = None
    target: Bounds | None = None
    ceiling: Callable[[Rows], float] | None = None

    def select(self, rows: Rows) -> Rows:
        """The rows that count."""
        return where(*self.conditions)(rows)


@dataclass(frozen=True)
class Words:
    """What a table of claims may name: conditions and numbers of a row, measures of many rows,
    ceilings; bands: conditions "word ≥ 8", "word 3 to 5", of the lowest and highest value."""

    conditions: dict[str, Condition]
    numbers: dict[str, Number] = field(default_factory=dict)
    measures: dict[str, Measure] = field(default_factory=dict)
    ceilings: dict[str, Callable[[Rows], float]] = field(default_factory=dict)
    bands: dict[str, Callable[[float, float], Condition]] = field(default_factory=dict)

    def claims(self, table: str) -> list[Claim]:
        """The claims of a table. Raises KeyError for a word that is none of these."""
        claims, subject = [], ""
        for line in filter(str.strip, table.splitlines()):
            if "|" not in line:
                subject = line.strip()
                continue
            quantity, rows, measure, *wanted = (cell.strip() for cell in line.split("|"))
            gate, target, ceiling = (*wanted, "", "", "")[:3]
            claims.append(
                Claim(
                    subject,
                    quantity,
                    tuple(map(self._condition, () if rows == "all" else rows.split(", "))),
                    self._measure(measure),
                    bounds_of(gate),
                    bounds_of(target),
                    self.ceilings[ceiling] if ceiling else None,
                )
            )
        return claims

    def _condition(self, text: str) -> Condition:
        word, low, high = _band(text)
        return self.bands[word](low, high) if word in self.bands else self.conditions[text]

    def _measure(self, text: str) -> Measure:
        kind, _, word = text.partition(" ")
        if kind == "share":
            return share_of(self.conditions[word])
        return STATISTICS[kind](self.numbers[word]) if kind in STATISTICS else self.measures[text]


def _band(text: str) -> tuple[str, float, float]:
    """A word and the bounds that follow it, infinite where there is none."""
    match = re.fullmatch(r"(.*?) (≥|≤)? ?([\d.]+)(?: to ([\d.]+))?", text)
    if match is None:
        return text, -np.inf, np.inf
    word, sign, value, high = match.groups()
    if sign == "≤":
        return word, -np.inf, float(value)
    return word, float(value), float(high) if high else np.inf


def bounds_of(text: str) -> Bounds | None:
    """Bounds as `bounds_text` writes them."""
    return _band(f"value {text}")[1:] if text else None


def where(*conditions: Condition) -> Callable[[Rows], Rows]:
    """Select the rows that meet every condition."""
    return lambda rows: [row for row in rows if all(condition(row) for condition in conditions)]


def share_of(condition: Condition) -> Measure:
    """Measure the share of rows that meet a condition."""
    return lambda rows: share(sum(map(bool, map(condition, rows))), len(rows))


def _values(number: Number, rows: Rows) -> np.ndarray:
    """A number of each row, or some, one after the other."""
    return np.concatenate([np.ravel(number(row)) for row in rows] or [np.zeros(0)]).astype(float)


def _largest(values: np.ndarray) -> dict:
    finite = values[~np.isnan(values)]
    return point(finite.max() if len(finite) else np.nan, len(finite))


STATISTICS: dict[str, Callable[[Number], Measure]] = {
    "median": lambda number: lambda rows: median(_values(number, rows)),
    "mean": lambda number: lambda rows: mean(_values(number, rows)),
    "largest": lambda number: lambda rows: _largest(_values(number, rows)),
}


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
