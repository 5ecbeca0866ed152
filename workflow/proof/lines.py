"""Lines of a summary: a share, or a statistic, with its interval and its number of recordings."""

from collections.abc import Callable

import numpy as np

from proof.intervals import bootstrap, wilson

SUMMARY = ("of", "what", "value", "low", "high", "hits", "n", "wanted", "met")


def share(of: str, what: str, hits: int, n: int, wanted: tuple | None = None) -> dict:
    """A line of the summary; wanted: (lowest, highest) value."""
    low, high = wilson(int(hits), int(n))
    value = hits / n if n else float("nan")
    return {**line(of, what, value, low, high, n, wanted), "hits": int(hits)}


def over(
    of: str,
    what: str,
    n: int,
    statistic: Callable[[np.ndarray], float],
    wanted: tuple | None = None,
) -> dict:
    """A line of a statistic(indices) over n recordings, its interval by bootstrap."""
    value = statistic(np.arange(n)) if n else float("nan")
    return line(of, what, value, *bootstrap(n, statistic), n, wanted)


def line(
    of: str, what: str, value: float, low: float, high: float, n: int, wanted: tuple | None
) -> dict:
    met = None
    if wanted is not None and not np.isnan(value):
        met = bool(wanted[0] <= value <= wanted[1])
    text = "" if wanted is None else _wanted(*wanted)
    head = {"of": of, "what": what, "value": float(value), "low": low, "high": high}
    return {**head, "hits": None, "n": int(n), "wanted": text, "met": met}


def _wanted(low: float, high: float) -> str:
    if high == np.inf:
        return f"≥ {low:g}"
    return f"≤ {high:g}" if low == -np.inf else f"{low:g} to {high:g}"


def median(values: np.ndarray) -> Callable[[np.ndarray], float]:
    return lambda index: float(np.median(values[index]))
