"""The one door to everything that is drawn: a case by its kind and seed.

draw("single:offset+rig", 3), draw("query:belief", 3), draw("real:iirc-tank:offset", 3)
"""

from typing import Any

from proof import planted, queries
from witness import cases, owned


def draw(kind: str, seed: int, **options: Any) -> Any:
    """A case of a kind; equal kinds, seeds and options give equal bits.

    query:…: a QueryCase, as `queries.draw`; owner:…: one of `witness.owned.draw`; real:…: a
    Planted, as `planted.draw`; skin: a Case without effects; everything else: a Case, as
    `witness.cases.draw`, which takes the options.
    """
    word = kind.partition(":")[0]
    if word == "query":
        return queries.draw(kind, seed)
    if word == "owner":
        return queries.of_owner(owned.draw(kind, seed))
    if word == "real":
        return planted.draw(kind, seed)
    return cases.draw("null" if word == "skin" else kind, seed, **options)
