"""What is tried where readings are not those of the skin that is believed: another instrument than
its owner's, alone and with what it calls for."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.estimates import UNTOLD
from eitskin.diagnose.fitting.fit import Fit, Problem
from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.search import afar

TOLD = np.log(UNTOLD) / (2.0 * NORMAL_90)  # sd of a size's logarithm


def foreign(effects: list[Candidate]) -> bool:
    """Whether the instrument is another than its owner's by some of these effects."""
    return any(candidate.effect.last_resort for candidate in effects)


def told(fitted: Fit) -> bool:
    """Whether a fit tells how large its last resort is; else it might be anything."""
    sd = np.sqrt(np.diag(fitted.covariance))
    last = [i for i, one in enumerate(fitted.effects) if one.effect.last_resort]
    return all((sd[fitted.place(i)] < TOLD).all() for i in last)


def tried(candidates: list[Candidate], resorts: list[Candidate]) -> Iterator[list[Candidate]]:
    """Each of the last resorts, then it with the candidates that may come with it, as large as they
    may be there."""
    for resort in resorts:
        large = [
            replace(c, scales=replace(c.scales, times=resort.effect.last_resort[c.name][0]))
            for c in [resort, *candidates]
            if c.name in resort.effect.last_resort and c.scope in ("", "common")
        ]
        yield from (large[:count] for count in range(1, len(large) + 1))


def starts(group: list[Candidate]) -> list[tuple[float, ...]]:
    """The coordinates from which fits of such a group begin."""
    known = group[0].effect.last_resort
    return list(product(*(known[candidate.name][1] for candidate in group)))


def nearest(
    problem: Problem,
    effects: list[Candidate],
    theta: np.ndarray,
    groups: list[list[Candidate]],
) -> list[list[Candidate]]:
    """Of the groups of the same names, beside effects at theta (P,), the one that begins nearest to
    the readings."""
    found: dict[tuple, tuple[float, list[Candidate]]] = {}
    for group in groups:
        misfit, _ = afar.start(problem, effects, theta, group, starts(group))
        names = tuple(candidate.name for candidate in group)
        if misfit < found.get(names, (np.inf,))[0]:
            found[names] = misfit, group
    return [group for _, group in found.values()]
