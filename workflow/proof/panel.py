"""Which cases a block has: their kinds, who simulates them and how plain each is to be.

A block is as large as the configuration says; its parts keep their shares. Everything is drawn
from the block's root, and what has no name of its own stands in a drawn order.
"""

import sys
from dataclasses import dataclass, replace

import numpy as np

from proof import confusable, planted, sealing
from proof.naming import names
from witness.cases import together
from witness.generators import GENERATORS, LAWS
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

REAL = "real"
GAPS = (3.0, 5.0, 8.0, 12.0, 20.0, 40.0)  # wanted of singles and sets, in turn
SHARES = {  # of a block of 300
    "null": 57,
    "single": 105,
    "pair": 18,
    "confusable": 18,
    "triple": 18,
    "decoy": 24,
    "outside": 36,
    REAL: 24,
}
LEVEL_DRAWN = ("null", "decoy", "outside", REAL)  # groups without a wanted gap
RECORDED = "recorded"  # the generator of real recordings
DEEP = "third-dimension"
DEEP_COMPANIONS = ("null", "single", "decoy")  # of every body, as many owners tell of one in vain
LAST = ("gate", "final")  # blocks in which laws are that nothing was tuned on


@dataclass(frozen=True)
class Planned:
    """One case of a block. kind, seed: as what draws it takes them; names: of its effects (None: a
    law outside the catalogue, or a real recording); gap: the wanted one (None: the noise is drawn);
    deep: the owner tells of a body."""

    kind: str
    seed: int
    generator: str
    names: tuple[str, ...] | None
    gap: float | None
    deep: bool = False


def numbers(size: int, groups: tuple[str, ...]) -> dict[str, int]:
    """How many cases of each group a block of `size` has: by SHARES, largest remainders first."""
    total = sum(SHARES[group] for group in groups)
    exact = {group: size * SHARES[group] / total for group in groups}
    found = {group: int(share) for group, share in exact.items()}
    rest = sorted(groups, key=lambda group: found[group] - exact[group])
    for group in rest[: size - sum(found.values())]:
        found[group] += 1
    return found


def plan(block: str, size: int, root: bytes) -> dict[str, Planned]:
    """The cases of a block by name. Where real recordings are absent their share is the others',
    with a line on stderr that says so."""
    rng = np.random.default_rng(int.from_bytes(sealing.derived(root, "panel")))
    groups = tuple(SHARES)
    real: list[str] = []
    if numbers(size, groups)[REAL]:
        real = planted.kinds()
        if not real:
            groups = tuple(group for group in SHARES if group != REAL)
            print(f"SKIPPED: no real recordings for block {block}", file=sys.stderr)
    count = numbers(size, groups)
    laws = list(LAWS if block in LAST else OUTSIDE)
    drawn: dict[str, list[tuple[str, tuple[str, ...] | None]]] = {
        "null": [("null", ())] * count["null"],
        "single": [(f"single:{n}", (n,)) for n in _turns(rng, list(DRAWN), count["single"])],
        "pair": [("pair", _set(rng, 2)) for _ in range(count["pair"])],
        "confusable": [
            (confusable.PAIR, cell) for cell in _turns(rng, confusable.cells(), count["confusable"])
        ],
        "triple": [("triple", _set(rng, 3)) for _ in range(count["triple"])],
        "decoy": [_decoy(rng, kind) for kind in _turns(rng, _decoys(), count["decoy"])],
        "outside": [(f"outside:{law}", None) for law in _turns(rng, laws, count["outside"])],
        REAL: [(kind, None) for kind in _turns(rng, real, count.get(REAL, 0))],
    }
    planned = []
    for group, members in drawn.items():
        gaps = _turns(rng, list(GAPS), len(members))
        for index, (kind, of) in enumerate(members):
            gap = None if group in LEVEL_DRAWN else gaps[index]
            planned.append(_planned(rng, group, index, kind, of, gap))
    planned = _with_companions(rng, planned)
    order = rng.permutation(size)
    return {name: planned[i] for name, i in zip(names(size), order, strict=True)}


def _turns(rng: np.random.Generator, members: list, count: int) -> list:
    """`count` of the members, every one once before any comes again, in drawn orders."""
    found: list = []
    while len(found) < count:
        found += [members[i] for i in rng.permutation(len(members))]
    return found[:count]


def _set(rng: np.random.Generator, size: int) -> tuple[str, ...]:
    while True:
        chosen = tuple(rng.choice(sorted(DRAWN), size, replace=False).tolist())
        if together(chosen):
            return chosen


def _decoys() -> list[str]:
    return [kind for kind in confusable.kinds() if kind.startswith(confusable.DECOY)]


def _decoy(rng: np.random.Generator, kind: str) -> tuple[str, tuple[str, ...]]:
    others = confusable.confounders(kind.partition(":")[2])
    return kind, (others[int(rng.integers(len(others)))],)


def _planned(
    rng: np.random.Generator,
    group: str,
    index: int,
    kind: str,
    of: tuple[str, ...] | None,
    gap: float | None,
) -> Planned:
    seed = int(rng.integers(2**31))
    if group == REAL:
        return Planned(kind, seed, RECORDED, None, None)
    words = [kind] if of is None else ["null", *(f"single:{name}" for name in of)]
    body, told = DEEP in (of or ()), kind == f"{confusable.DECOY}:{DEEP}"
    able = [
        name
        for name, one in GENERATORS.items()
        if all(one.can(w) for w in words) and not (told and one.solid)
    ]
    turn = index if group == "null" else int(rng.integers(len(able)))
    return Planned(kind, seed, able[turn % len(able)], of, gap, body or told)


def _with_companions(rng: np.random.Generator, planned: list[Planned]) -> list[Planned]:
    """For every body one null, one single and one decoy, where there are, whose owners tell of a
    body too, though the skin conducts as a sheet: none whose generator solves every depth."""
    planned = list(planned)
    for _ in range(sum(DEEP in (one.names or ()) for one in planned)):
        for group in DEEP_COMPANIONS:
            shallow = [
                i
                for i, one in enumerate(planned)
                if one.kind.partition(":")[0] == group
                and not (one.deep or GENERATORS[one.generator].solid)
            ]
            if shallow:
                i = shallow[int(rng.integers(len(shallow)))]
                planned[i] = replace(planned[i], deep=True)
    return planned
