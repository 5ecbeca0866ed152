"""Which recordings a calibration is made of: kinds and seeds, in blocks that share none."""

from eitskin.errors import InputError
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

FIRST_SEED = {  # of every kind; sizes stay far below the step
    "development": 1,
    "report": 200_001,
    "ordinary-development": 1,
    "ordinary-report": 200_001,
    "p-values-development": 1,
    "p-values-report": 200_001,
}
SIZES = {
    "quick": {"null": 60, "single": 4, "pair": 24, "triple": 16, "outside": 36},
    "full": {"null": 150, "single": 4, "pair": 60, "triple": 40, "outside": 60},
}
ORDINARY_SIZES = {
    "quick": {"null": 100, "single": 1, "pair": 12, "triple": 0, "outside": 0},
    "full": {"null": 300, "single": 4, "pair": 40, "triple": 0, "outside": 0},
}
SKINS = {"quick": 8, "full": 40}  # of the blocks of p-values, each recorded many times
BATCH = 8
TABLES = ("summary", "effects", "confusion", "other_calibration", "rig")
P_VALUE_TABLES = ("summary", "p_values")


def of_p_values(block: str) -> bool:
    """Whether a block's trials are skins with nothing left out, recorded again and again."""
    return block.startswith("p-values-")


def tables(block: str) -> tuple[str, ...]:
    """Names of the .csv that a block's score is."""
    return P_VALUE_TABLES if of_p_values(block) else TABLES


def trials(block: str, size: str) -> list[tuple[str, int]]:
    """(kind, seed) of every recording, as `witness.cases.draw` takes them.

    block: "development" (seeds from 1), to tune on, or "report" (seeds from 200 001), to report;
    with ordinary- before it, the same skins recorded by rigs with errors of their own; with
    p-values- before it, skins, of kind "skin", for `nulls.trial`. size: a key of SIZES: numbers of
    recordings, of "single" for each name that the witness can draw; those of "outside" are spread
    over its laws. Every stretch holds about the same mixture. A smaller size is part of the larger.
    Raises InputError for an unknown block or size.
    """
    for key, value, known in (("block", block, FIRST_SEED), ("size", size, SIZES)):
        if value not in known:
            raise InputError("calibration", key, repr(value), " or ".join(known))
    if of_p_values(block):
        return [("skin", FIRST_SEED[block] + i) for i in range(SKINS[size])]
    ordinary = block.startswith("ordinary-")
    first, number = FIRST_SEED[block], (ORDINARY_SIZES if ordinary else SIZES)[size]
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
    placed = [((i + 0.5) / len(group), trial) for group in groups for i, trial in enumerate(group)]
    rig = "+rig" if ordinary else ""
    return [(kind + rig, seed) for _, (kind, seed) in sorted(placed, key=lambda pair: pair[0])]


def batches(block: str, size: str) -> list[list[tuple[str, int]]]:
    """`trials`, BATCH at a time: a job each."""
    whole = trials(block, size)
    return [whole[i : i + BATCH] for i in range(0, len(whole), BATCH)]
