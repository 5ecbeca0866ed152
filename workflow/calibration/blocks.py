"""Which recordings a calibration is made of: kinds and seeds, in blocks that share none."""

from eitskin.errors import InputError
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

FIRST_SEED = {  # of every kind; sizes stay far below the step
    "development": 1,
    "report": 200_001,
    "ordinary-development": 1,
    "ordinary-report": 200_001,
    "queries-development": 1,
    "queries-report": 200_001,
}
SIZES = {
    "quick": {"null": 60, "single": 4, "pair": 24, "triple": 16, "outside": 36},
    "full": {"null": 150, "single": 4, "pair": 60, "triple": 40, "outside": 60},
}
ORDINARY_SIZES = {
    "quick": {"null": 100, "single": 1, "pair": 12, "triple": 0, "outside": 0},
    "full": {"null": 300, "single": 4, "pair": 40, "triple": 0, "outside": 0},
}
QUERY_SIZES = {  # kinds of `asked.draw`
    "quick": {"rig": 5, "belief": 3, "foreign": 3, "shuffled": 3, "garbage": 3, "real": 3},
    "full": {"rig": 50, "belief": 30, "foreign": 30, "shuffled": 30, "garbage": 30, "real": 30},
}
BATCH = 8
TABLES = ("summary.csv", "summary.md", "effects.csv", "confusion.csv", "other_calibration.csv")
TABLES = (*TABLES, "rig.csv")
QUERY_TABLES = ("summary.csv", "summary.md", "queries.csv")


def trials(block: str, size: str) -> list[tuple[str, int]]:
    """(kind, seed) of every recording, as `witness.cases.draw` or, of queries, `asked.draw` takes
    them.

    block: "development" (seeds from 1), to tune on, or "report" (seeds from 200 001), to report;
    with ordinary- before it, the same skins recorded by rigs with errors of their own; with
    queries-, recordings of any sort whose queries are compared. size: a key of SIZES: numbers of
    recordings, of "single" for each name that the witness can draw; those of "outside" are spread
    over its laws. Every stretch holds about the same mixture. A smaller size is part of the larger.
    Raises InputError for an unknown block or size.
    """
    for key, value, known in (("block", block, FIRST_SEED), ("size", size, SIZES)):
        if value not in known:
            raise InputError("calibration", key, repr(value), " or ".join(known))
    first = FIRST_SEED[block]
    if of_queries(block):
        parts = QUERY_SIZES[size].items()
        return _mixed([[(f"query:{kind}", first + i) for i in range(n)] for kind, n in parts])
    ordinary = block.startswith("ordinary-")
    number = (ORDINARY_SIZES if ordinary else SIZES)[size]
    groups = [
        [(kind, first + i) for i in range(number[kind])] for kind in ("null", "pair", "triple")
    ]
    names, laws = list(DRAWN), list(OUTSIDE)
    groups.append([(f"single:{n}", first + i) for i in range(number["single"]) for n in names])
    groups.append(
        [
            (f"outside:{laws[i % len(laws)]}", first + i // len(laws))
            for i in range(number["outside"])
        ]
    )
    rig = "+rig" if ordinary else ""
    return [(kind + rig, seed) for kind, seed in _mixed(groups)]


def _mixed(groups: list[list[tuple[str, int]]]) -> list[tuple[str, int]]:
    """All of some groups, each spread evenly over the whole."""
    placed = [((i + 0.5) / len(group), trial) for group in groups for i, trial in enumerate(group)]
    return [trial for _, trial in sorted(placed, key=lambda pair: pair[0])]


def of_queries(block: str) -> bool:
    """Whether a block is of queries that are compared before and after."""
    return block.startswith("queries-")


def tables(block: str) -> tuple[str, ...]:
    """Names of the files that a block's score is."""
    return QUERY_TABLES if of_queries(block) else TABLES


def batches(block: str, size: str) -> list[list[tuple[str, int]]]:
    """`trials`, BATCH at a time: a job each."""
    whole = trials(block, size)
    return [whole[i : i + BATCH] for i in range(0, len(whole), BATCH)]
