"""Which cases a sealed block has: their kinds, who simulates them and how plain each is to be.

A block is as large as the configuration says; its parts keep their shares. Everything is drawn
from the block's root, and what has no name of its own stands in a drawn order. What looks like what
is what the catalogue declares of each effect (`confusable`), taken both ways.
"""

import sys
from dataclasses import dataclass, replace

import numpy as np

from eitskin.effects import EFFECTS
from proof import planted, sealing
from proof.blocks import case_names
from witness.cases import together
from witness.generators import GENERATORS, LAWS
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

REAL = "real"
PAIR, DECOY = "confusable", "decoy"
GAPS = (3.0, 5.0, 8.0, 12.0, 20.0, 40.0)  # wanted of singles and sets, in turn
SHARES = {  # of a block of 300
    "null": 57,
    "single": 105,
    "pair": 18,
    PAIR: 18,
    "triple": 18,
    DECOY: 24,
    "outside": 36,
    REAL: 24,
}
LEVEL_DRAWN = ("null", DECOY, "outside", REAL)  # groups without a wanted gap
RECORDED = "recorded"  # the generator of real recordings
DEEP = "third-dimension"
DEEP_COMPANIONS = ("null", "single", DECOY)  # of every body, as many owners tell of one in vain
UNTUNED = ("gate", "final")  # blocks in which laws are that nothing was tuned on
Names = tuple[str, ...]


@dataclass(frozen=True)
class Planned:
    """One case of a block. kind, seed: as what draws it takes them; names: of its effects (None: a
    law outside the catalogue, or a real recording); gap: the wanted one (None: the noise is drawn);
    deep: the owner tells of a body."""

    kind: str
    seed: int
    generator: str
    names: Names | None
    gap: float | None
    deep: bool = False

    @property
    def group(self) -> str:
        """A key of SHARES."""
        return self.kind.partition(":")[0]


def confounders(name: str) -> list[str]:
    """The names that look like `name`, of those that the witness draws."""
    declared = set(EFFECTS[name].confusable)
    return sorted(o for o in DRAWN if o in declared or name in EFFECTS[o].confusable)


def cells() -> list[tuple[str, str]]:
    """Pairs of names that are mistaken for one another, in alphabetical order, of those that the
    witness can put into one recording."""
    return [
        (name, rival)
        for name in sorted(DRAWN)
        for rival in confounders(name)
        if name < rival and together((name, rival))
    ]


def numbers(size: int, groups: tuple[str, ...]) -> dict[str, int]:
    """How many cases of each group a block of `size` has: by SHARES, largest remainders first."""
    total = sum(SHARES[group] for group in groups)
    exact = {group: size * SHARES[group] / total for group in groups}
    number = {group: int(share) for group, share in exact.items()}
    by_remainder = sorted(groups, key=lambda group: number[group] - exact[group])
    for group in by_remainder[: size - sum(number.values())]:
        number[group] += 1
    return number


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
    laws = list(LAWS if block in UNTUNED else OUTSIDE)
    decoys = [f"{DECOY}:{name}" for name in DRAWN if confounders(name)]
    # The random stream is read in this order.
    members: dict[str, list[tuple[str, Names | None]]] = {
        "null": [("null", ())] * count["null"],
        "single": [(f"single:{n}", (n,)) for n in _turns(rng, list(DRAWN), count["single"])],
        "pair": [("pair", _set(rng, 2)) for _ in range(count["pair"])],
        PAIR: [(PAIR, cell) for cell in _turns(rng, cells(), count[PAIR])],
        "triple": [("triple", _set(rng, 3)) for _ in range(count["triple"])],
        DECOY: [_decoy(rng, kind) for kind in _turns(rng, decoys, count[DECOY])],
        "outside": [(f"outside:{law}", None) for law in _turns(rng, laws, count["outside"])],
        REAL: [(kind, None) for kind in _turns(rng, real, count.get(REAL, 0))],
    }
    planned = []
    for group, pairs in members.items():
        gaps = _turns(rng, list(GAPS), len(pairs))
        for index, (kind, names) in enumerate(pairs):
            gap = None if group in LEVEL_DRAWN else gaps[index]
            planned.append(_planned(rng, index, kind, names, gap))
    planned = _with_companions(rng, planned)
    order = rng.permutation(size)
    return {name: planned[i] for name, i in zip(case_names(size), order, strict=True)}


def _turns(rng: np.random.Generator, members: list, count: int) -> list:
    """`count` of the members, every one once before any comes again, in drawn orders."""
    turns: list = []
    while len(turns) < count:
        turns += [members[i] for i in rng.permutation(len(members))]
    return turns[:count]


def _set(rng: np.random.Generator, size: int) -> Names:
    while True:
        names = tuple(rng.choice(sorted(DRAWN), size, replace=False).tolist())
        if together(names):
            return names


def _decoy(rng: np.random.Generator, kind: str) -> tuple[str, Names]:
    rivals = confounders(kind.partition(":")[2])
    return kind, (rivals[int(rng.integers(len(rivals)))],)


def _planned(
    rng: np.random.Generator, index: int, kind: str, names: Names | None, gap: float | None
) -> Planned:
    """A case with a drawn seed and a drawn generator; nulls, by their index, have each in turn."""
    seed = int(rng.integers(2**31))
    if kind.partition(":")[0] == REAL:
        return Planned(kind, seed, RECORDED, None, None)
    words = [kind] if names is None else ["null", *(f"single:{name}" for name in names)]
    has_body, is_body_decoy = DEEP in (names or ()), kind == f"{DECOY}:{DEEP}"
    able = [
        name
        for name, generator in GENERATORS.items()
        if all(generator.can(w) for w in words) and not (is_body_decoy and generator.solid)
    ]
    turn = index if kind == "null" else int(rng.integers(len(able)))
    return Planned(kind, seed, able[turn % len(able)], names, gap, has_body or is_body_decoy)


def _with_companions(rng: np.random.Generator, planned: list[Planned]) -> list[Planned]:
    """For every body one null, one single and one decoy, where there are, whose owners tell of a
    body too, though the skin conducts as a sheet: none whose generator solves every depth."""
    planned = list(planned)
    for _ in range(sum(DEEP in (case.names or ()) for case in planned)):
        for group in DEEP_COMPANIONS:
            shallow = [
                i
                for i, case in enumerate(planned)
                if case.group == group and not (case.deep or GENERATORS[case.generator].solid)
            ]
            if shallow:
                i = shallow[int(rng.integers(len(shallow)))]
                planned[i] = replace(planned[i], deep=True)
    return planned
