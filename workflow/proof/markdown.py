"""Parts of pages in Markdown: tables, numbers, and the cells of a score's line."""

from collections.abc import Iterable

import numpy as np


def table(head: tuple, lines: Iterable[tuple]) -> list[str]:
    """Lines of a table in Markdown."""
    rows = ["| " + " | ".join(map(str, line)) + " |" for line in lines]
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *rows]


def measured_cells(line: dict) -> tuple:
    """Subject, quantity, value, interval and number of a line, as cells of a
    table."""
    share = is_share(line)
    ends = [number(line[end], share) for end in ("low", "high")]
    interval = " to ".join(ends) if all(ends) else ""
    return line["of"], line["what"], number(line["value"], share), interval, line["n"]


def is_share(line: dict) -> bool:
    """Whether a line's value is a share."""
    return line["hits"] is not None and not np.isnan(line["hits"])


def number(value: float | None, share: bool) -> str:
    """A value of a score, in percent where it is a share; nothing where it is not known."""
    if value is None or np.isnan(value):
        return ""
    return f"{100 * value:.1f} %" if share else f"{value:.3g}"
