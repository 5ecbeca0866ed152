"""Which fault explains the difference of two sessions, and how much better than any other.

The evidence for a fault is the logarithm of the likelihood ratio of the difference with and without
it, its free sizes at their best and the scale of the wandering unknown but for what the scatter
within sessions says of it, less half the logarithm of the number of values for each free size
(Schwarz 1978) and the logarithm of the number of sites that it might have had: nats.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import comb, log

import numpy as np

from eitskin.diagnose.comparison.faults import Signature
from eitskin.diagnose.comparison.wander import Wander

MOST_SITES = 3  # of one fault
ADDED = 6.0  # nats that one more site must bring
MANY = 40  # of a family beyond which only those that take most by themselves are looked at
TINY = 1e-6  # of a signature's square that is left once what others explain is taken away


@dataclass(frozen=True)
class Explained:
    """What explains a difference: signatures of one kind of fault, one a site, their evidence;
    spread: whether yet more sites would add to it, so that it is no fault of a few."""

    parts: tuple[Signature, ...]
    evidence: float
    spread: bool = False

    @property
    def name(self) -> str:
        """The fault's."""
        return self.parts[0].name

    @property
    def place(self) -> tuple[str | None, tuple[int, ...]]:
        """Kind and numbers of the sites."""
        return self.parts[0].kind, tuple(sorted(s for part in self.parts for s in part.sites))


class Evidence:
    """The difference of two sessions, to be explained; `known` are explained already."""

    def __init__(self, wander: Wander, known: Iterable[Signature] = ()):
        self.wander = wander
        self.left = wander.across(wander.change)
        self.basis = np.zeros((len(self.left), 0))
        for part in known:
            self.left, self.basis, _ = self._taken(part, self.left, self.basis)
        self.count = wander.count - self.basis.shape[1] + wander.prior
        self.before = _square(self.left)

    def _taken(
        self, part: Signature, left: np.ndarray, basis: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """What is left of the difference, what has been explained, with one part more, and how
        much of the square it took."""
        gained = 0.0
        if part.shift is not None:
            shift = self.wander.across(part.shift)
            rest = left - (shift - basis @ (basis.T @ shift))
            gained, left = _square(left) - _square(rest), rest
        if part.basis.shape[1]:
            free = _spanned(self.wander.across(part.basis), basis)
            taken = free.T @ left
            gained += _square(taken)
            left = left - free @ taken
            basis = np.column_stack([basis, free])
        return left, basis, gained

    def of(self, parts: Sequence[Signature], among: int) -> Explained:
        """The evidence for parts, each one of so many that there might be."""
        left, basis, gained = self.left, self.basis, 0.0
        for part in parts:
            left, basis, more = self._taken(part, left, basis)
            gained += more
        free = basis.shape[1] - self.basis.shape[1]
        known = self.wander.prior or 1e-9 * self.before
        ratio = (self.before + known) / (max(self.before - gained, 0.0) + known)
        nats = 0.5 * self.count * log(ratio) - 0.5 * free * log(self.count)
        return Explained(tuple(parts), nats - log(comb(among, len(parts))))

    def best(self, family: Sequence[Signature]) -> Explained:
        """The best of a family, with more sites as long as each brings enough."""
        chosen = self.of([self._next((), family)], len(family))
        while len(chosen.parts) < len(family):
            more = self._next(chosen.parts, family)
            joined = self.of([*chosen.parts, more], len(family))
            if joined.evidence < chosen.evidence + ADDED:
                break
            if len(chosen.parts) == MOST_SITES:
                return replace(chosen, spread=True)
            chosen = joined
        return chosen

    def elsewhere(self, chosen: Explained, family: Sequence[Signature]) -> Explained:
        """The best of a family with one of the sites chosen exchanged for another."""
        found = []
        for part in chosen.parts:
            rest = tuple(p for p in chosen.parts if p is not part)
            left = [p for p in family if p is not part]
            if len(left) > len(rest):
                found.append(self.of([*rest, self._next(rest, left)], len(family)))
        return max(found, key=lambda e: e.evidence, default=replace(chosen, evidence=-np.inf))

    def _next(self, chosen: Sequence[Signature], family: Sequence[Signature]) -> Signature:
        """The one of a family that takes most of what the chosen ones leave."""
        left, basis = self.left, self.basis
        for part in chosen:
            left, basis, _ = self._taken(part, left, basis)
        others = [part for part in family if not any(part is c for c in chosen)]
        if len(others) > MANY and all(part.basis.shape[1] == 1 for part in others):
            columns = self.wander.across(np.column_stack([part.basis[:, 0] for part in others]))
            columns -= basis @ (basis.T @ columns)
            length = np.maximum((columns**2).sum(axis=0), np.finfo(float).tiny)
            taken = (left @ columns) ** 2 / length
            others = [others[i] for i in np.argsort(-taken)[:MANY]]
        return max(others, key=lambda part: self._taken(part, left, basis)[2])


def _square(left: np.ndarray) -> float:
    return float(left @ left)


def _spanned(columns: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what columns add to another."""
    length = np.sqrt((columns**2).sum(axis=0))
    columns = columns[:, length > 0] / length[length > 0]
    rest = columns - basis @ (basis.T @ columns)
    square, turn = np.linalg.eigh(rest.T @ rest)
    kept = square > TINY
    return rest @ (turn[:, kept] / np.sqrt(square[kept]))
