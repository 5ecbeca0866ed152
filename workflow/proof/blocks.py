"""Which recordings an open block is made of: kinds and seeds, in blocks that share none; ordinary
ones, those by rigs with errors in other forms and those of p-values record skins of the plain ones
anew. Names of a sealed block's cases.

A block is measured, for instance, by
snakemake --cores 2 calibrate_diagnosis --config "calibration={block: controls-report, size: full}"
"""

from eitskin.errors import InputError
from witness import controls
from witness.cases import ON_OUTLINES
from witness.outside import OUTSIDE
from witness.owned import KINDS
from witness.strengths import DRAWN

# Of every kind; sizes stay far below the step. Rows of blocks that have been seen led to mends, so
# that their kind is reported from seeds further on.
FIRST_SEED = {
    "development": 1,
    "report": 700_001,
    "ordinary-development": 1,
    "ordinary-report": 700_001,
    "alien-development": 1,
    "alien-report": 700_001,
    "alien-sealed": 900_001,
    "p-values-development": 1,
    "p-values-report": 600_001,
    "queries-development": 1,
    "queries-report": 800_001,
    "owners-development": 1,
    "owners-report": 600_001,
    "controls-development": 1,
    "controls-report": 500_001,
    "outlines-development": 1,
    "outlines-report": 650_001,
}
SIZES = {
    "quick": {"null": 60, "single": 4, "pair": 24, "triple": 16, "outside": 36},
    "full": {"null": 150, "single": 4, "pair": 60, "triple": 40, "outside": 60},
}
ORDINARY_SIZES = {
    "quick": {"null": 100, "single": 1, "pair": 12, "triple": 0, "outside": 18},
    "full": {"null": 300, "single": 4, "pair": 40, "triple": 0, "outside": 54},
}
ALIEN_SIZES = {
    "quick": {"null": 20, "single": 1, "pair": 4, "triple": 0, "outside": 6},
    "full": {"null": 300, "single": 4, "pair": 40, "triple": 0, "outside": 60},
}
OUTLINE_SIZES = {  # half of them by rigs with errors of their own
    "quick": {"null": 16, "single": 1},
    "full": {"null": 60, "single": 2},
}
P_VALUE_SIZES = {"quick": {"skin": 8}, "full": {"skin": 40}}  # each recorded many times
QUERY_SIZES = {  # kinds of `queries.draw`
    "quick": {"rig": 5, "belief": 3, "foreign": 3, "shuffled": 3, "garbage": 3, "real": 3},
    "full": {"rig": 50, "belief": 30, "foreign": 30, "shuffled": 30, "garbage": 30, "real": 30},
}
OWNER_SIZES = {  # kinds of `owned.draw`; 40 in all
    "quick": dict.fromkeys(KINDS, 1),
    "full": {
        "static-body": 8,
        "out-of-round": 6,
        "clipped": 5,
        "step": 6,
        "many-drives": 5,
        "order": 3,
        "polarity": 3,
        "beliefs": 4,
    },
}
CONTROL_SIZES = {  # kinds of `controls.draw`
    "quick": {
        **dict.fromkeys((f"white-{percent}" for percent in controls.WHITE_PERCENT), 2),
        "single-frame": 10,
        "averaged-frames": 10,
        "unlabelled-white": 3,
        "unlabelled-alien": 3,
        "common-place": 6,
        "common-force-zero": 3,
        "common-force-factor": 3,
        "delay-force": 3,
        "delay-pose": 3,
        "strong-pair": 4,
    },
    "full": {
        **dict.fromkeys((f"white-{percent}" for percent in controls.WHITE_PERCENT), 40),
        "single-frame": 100,
        "averaged-frames": 100,
        "unlabelled-white": 20,
        "unlabelled-alien": 20,
        "common-place": 60,
        "common-force-zero": 30,
        "common-force-factor": 30,
        "delay-force": 30,
        "delay-pose": 30,
        "strong-pair": 40,
    },
}
BATCH = 8  # recordings a job: some ten minutes
TABLES = {  # by sort
    "diagnoses": ("summary", "effects", "confusion", "other_calibration", "rig", "rig_sizes"),
    "p-values": ("summary", "p_values"),
    "queries": ("summary", "queries"),
    "owners": ("summary", "owners"),
    "controls": ("summary", "controls"),
}
Trial = tuple[str, int]  # kind and seed


def sort_of(block: str) -> str:
    """What a block is of, a key of TABLES: recordings that are diagnosed and judged; skins with
    nothing left out, recorded again and again; queries that are compared before and after; what
    owners have, checked and diagnosed; controls, of which one thing is judged each."""
    return next((sort for sort in TABLES if block.startswith(f"{sort}-")), "diagnoses")


def tables(block: str) -> tuple[str, ...]:
    """Names of the .csv that a block's score is; summary.md is beside them."""
    return TABLES[sort_of(block)]


def trials(block: str, size: str) -> list[Trial]:
    """(kind, seed) of every trial, as `trial.row` takes them.

    block: "development" (seeds from 1), to tune on, or "report" (seeds far from those), to report;
    with ordinary- before it, the same skins recorded by rigs with errors of their own; with alien-,
    by rigs with errors in forms that nobody modelled, those of the block alien-sealed with sealed
    ones, on which nobody tunes; with
    outlines- before it, skins that are no discs, half of them by rigs with errors; with
    p-values- before it, skins, of kind "skin", for `nulls.trial`; with queries-, recordings of any
    sort, of kinds that `queries.draw` knows; with owners-, of kinds that `owned.draw` does; with
    controls-, of those of `controls.draw`. size: a
    key of SIZES: numbers of recordings, of "single" for each name that the witness can draw; those
    of "outside" are spread over its laws. Every stretch holds about the same mixture. A smaller
    size is part of the larger. Raises InputError for an unknown block or size.
    """
    for key, value, allowed in (("block", block, FIRST_SEED), ("size", size, SIZES)):
        if value not in allowed:
            raise InputError("calibration", key, repr(value), " or ".join(allowed))
    start = FIRST_SEED[block]
    if sort_of(block) == "p-values":
        return _mixed(_each(P_VALUE_SIZES[size], start))
    if sort_of(block) == "queries":
        return _mixed(_each({f"query:{kind}": n for kind, n in QUERY_SIZES[size].items()}, start))
    if sort_of(block) == "owners":
        return _mixed(_each({f"owner:{kind}": n for kind, n in OWNER_SIZES[size].items()}, start))
    if sort_of(block) == "controls":
        numbers = CONTROL_SIZES[size]
        return _mixed(_each({f"control:{kind}": n for kind, n in numbers.items()}, start))
    if block.startswith("ordinary-"):
        return [(f"{kind}+rig", seed) for kind, seed in _drawn(ORDINARY_SIZES[size], start)]
    if block.startswith("outlines-"):
        plan = _mixed(_outlines(OUTLINE_SIZES[size], start))
        return [(f"{kind}{('+outline', '+outline+rig')[seed % 2]}", seed) for kind, seed in plan]
    if block.startswith("alien-"):
        word = "sealed" if block == "alien-sealed" else "alien"
        return [(f"{kind}+{word}", seed) for kind, seed in _drawn(ALIEN_SIZES[size], start)]
    return _drawn(SIZES[size], start)


def _each(number: dict[str, int], start: int) -> list[list[Trial]]:
    """So many seeds of each kind, from `start` on."""
    return [[(kind, start + i) for i in range(n)] for kind, n in number.items()]


def _drawn(number: dict[str, int], start: int) -> list[Trial]:
    groups = _each({kind: number[kind] for kind in ("null", "pair", "triple")}, start)
    names, laws = list(DRAWN), list(OUTSIDE)
    groups.append([(f"single:{n}", start + i) for i in range(number["single"]) for n in names])
    turns = [divmod(i, len(laws)) for i in range(number["outside"])]
    groups.append([(f"outside:{laws[law]}", start + turn) for turn, law in turns])
    return _mixed(groups)


def _outlines(number: dict[str, int], start: int) -> list[list[Trial]]:
    """Nulls, and singles of every name that outlines have, odd and even seeds by turns."""
    singles = [
        (f"single:{name}", start + i + turn % 2)
        for i in range(number["single"])
        for turn, name in enumerate(ON_OUTLINES)
    ]
    return [*_each({"null": number["null"]}, start), singles]


def _mixed(groups: list[list[Trial]]) -> list[Trial]:
    """All of some groups, each spread evenly over the whole."""
    placed = [((i + 0.5) / len(group), trial) for group in groups for i, trial in enumerate(group)]
    return [trial for _, trial in sorted(placed, key=lambda pair: pair[0])]


def batches(block: str, size: str) -> list[list[Trial]]:
    """`trials`, BATCH at a time: a job each."""
    plan = trials(block, size)
    return [plan[i : i + BATCH] for i in range(0, len(plan), BATCH)]


def case_names(size: int) -> list[str]:
    """Names of a sealed block's cases: they tell the number and nothing else."""
    return [f"case-{number:03d}" for number in range(1, size + 1)]


def case_batches(size: int, batch: int) -> list[list[str]]:
    """The names of a sealed block's cases, `batch` at a time: a job each."""
    names = case_names(size)
    return [names[i : i + batch] for i in range(0, size, batch)]
