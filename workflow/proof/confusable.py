"""Effects that are mistaken for one another: in pairs, and each without the other.

What looks like what is what the catalogue declares of each effect (`confusable`), taken both ways.
"""

import zlib

import numpy as np

from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from witness import cases
from witness.strengths import DRAWN

PAIR, DECOY = "confusable", "decoy"


def confounders(name: str) -> list[str]:
    """The names that look like `name`, of those that the witness draws; [] for an unknown name."""
    if name not in DRAWN:
        return []
    declared = set(EFFECTS[name].confusable)
    return sorted(o for o in DRAWN if o in declared or name in EFFECTS[o].confusable)


def cells() -> list[tuple[str, str]]:
    """Pairs of names that are mistaken for one another, (first, second) in alphabetical order, of
    those that the witness can put into one recording."""
    return [
        (name, other)
        for name in sorted(DRAWN)
        for other in confounders(name)
        if name < other and cases.together((name, other))
    ]


def kinds() -> list[str]:
    """Every kind that can be drawn."""
    return [PAIR, *(f"{DECOY}:{name}" for name in DRAWN if confounders(name))]


def draw(kind: str, seed: int, frames: int | None = None) -> cases.Case:
    """One case. kind: confusable, both effects of a random cell; or decoy:<name>, one that looks
    like <name>, which itself is not there. Skin, frames, noise and strengths as `cases.draw` has
    them for sets and for singles. Raises InputError for an unknown kind.
    """
    word, _, name = kind.partition(":")
    if kind not in kinds():
        raise InputError("case", "kind", repr(kind), f"{PAIR} or {DECOY}:<name>")
    rng = np.random.default_rng([zlib.crc32(f"names of {kind}".encode()), seed])
    possible = cells() if word == PAIR else [(other,) for other in confounders(name)]
    return cases.draw(kind, seed, frames, names=list(possible[int(rng.integers(len(possible)))]))
