"""The one door to everything that is drawn: a case by its kind and seed.

draw("single:offset+rig", 3), draw("query:belief", 3), draw("real:iirc-tank:offset", 3),
draw("control:white-0.1", 3)
"""

import zlib
from typing import Any

from proof import planted, queries
from witness import cases, controls, owned
from witness.generators import GENERATORS

DEFAULT_GENERATOR = "boundary"
OUTLINE_GENERATOR = "elements"
CONTROL_GENERATORS = ("boundary", "disc")  # by turns; both solve noise of 0.01 %
OTHER_GENERATOR = 3  # every third recording, of those by rigs with errors in other forms


def draw(kind: str, seed: int, **options: Any) -> Any:
    """A case of a kind; equal kinds, seeds and options give equal bits.

    query:…: a QueryCase, as `queries.draw`; owner:…: one of `witness.owned.draw`; control:…: a
    Control, as `witness.controls.draw`; real:…: a Planted, as `planted.draw`; skin: a Case without
    effects; everything else: a Case, as `witness.cases.draw`, which takes the options; without one
    its solver is that of `generator`.
    """
    word = kind.partition(":")[0]
    if word == "query":
        return queries.draw(kind, seed)
    if word == "owner":
        return queries.of_owner(owned.draw(kind, seed))
    if word == "control":
        return controls.draw(kind, seed, generator(kind, seed))
    if word == "real":
        return planted.draw(kind, seed)
    case_kind = "null" if word == "skin" else kind
    return cases.draw(case_kind, seed, **{"generator": generator(case_kind, seed), **options})


def generator(kind: str, seed: int) -> str:
    """The solver of a case, of `witness.generators.GENERATORS`: the default one; with +alien or
    +sealed, of every third case one of the others that can solve its kind, in turn; of control:…,
    of CONTROL_GENERATORS one of each two seeds; on outlines OUTLINE_GENERATOR."""
    if kind.startswith("control:"):
        return CONTROL_GENERATORS[seed % len(CONTROL_GENERATORS)]
    plain, _, rig = kind.partition("+")
    if rig.partition("+")[0] == cases.OUTLINE:
        return OUTLINE_GENERATOR
    if rig.partition(":")[0] not in ("alien", "sealed"):
        return DEFAULT_GENERATOR
    turn, rest = divmod(zlib.crc32(plain.encode()) + seed, OTHER_GENERATOR)
    others = [
        name for name in GENERATORS if name != DEFAULT_GENERATOR and GENERATORS[name].can(plain)
    ]
    return DEFAULT_GENERATOR if rest or not others else others[turn % len(others)]
