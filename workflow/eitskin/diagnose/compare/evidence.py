"""Which fault explains the difference of two sessions, and how much better than any other.

The evidence for a fault is the logarithm of the likelihood ratio of the difference with and without
it, its free sizes at their best and the scale of the wandering unknown but for what the scatter
within sessions says of it, less half the logarithm of the number of values for each free size
(Schwarz 1978) and the logarithm of the number of sites that it might have had: nats. Where ordinary
sites of a kind move more than the scale says, one must stand out beside these.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import comb, log

import numpy as np
from scipy.stats import chi2

from eitskin.diagnose.compare.faults import Signature
from eitskin.diagnose.compare.wander import Wander

MOST_SITES = 3  # of one fault
MOST_FREE = 8  # sizes of a site beyond which it is the only one
ADDED = 6.0  # nats that one more site must bring
ADDED_SHARE = 0.05  # of the evidence of those before it, the same
SPREAD = 0.3  # of the evidence a site, what yet another one brings where there is no end to them
ORDINARY = 0.8  # of a kind's other sites, or all but LEFT_ASIDE, beside which one must stand out
LEFT_ASIDE = 3
FEWEST_ORDINARY = 4
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

    def of(
        self, parts: Sequence[Signature], family: Sequence[Signature], lively: float = 1.0
    ) -> Explained:
        """The evidence for parts of a family; lively: how much larger than by the scale the squares
        are that ordinary sites of the family take, with the explanation and without it."""
        left, basis, gained = self.left, self.basis, 0.0
        for part in parts:
            left, basis, more = self._taken(part, left, basis)
            gained += more
        free = basis.shape[1] - self.basis.shape[1]
        rest = 0.0
        if lively > 1.0:
            for part in self._chain(parts, family)[len(parts) :]:
                left, basis, more = self._taken(part, left, basis)
                rest += more
        known = self.wander.prior or max(TINY * self.before, np.finfo(float).tiny)
        after = lively * (_square(left) + known)
        ratio = (after + max(gained, 0.0) + rest) / (after + rest)
        nats = 0.5 * self.count * log(ratio) - 0.5 * free * log(self.count)
        return Explained(tuple(parts), nats - log(comb(len(family), len(parts))))

    def best(self, family: Sequence[Signature]) -> Explained:
        """The best of a family, with more sites as long as each brings enough."""
        lively = self.lively(family)
        chain = self._chain((), family)
        chosen = self.of(chain[:1], family, lively)
        for count in range(2, len(chain) + 1):
            joined = self.of(chain[:count], family, lively)
            if joined.evidence < chosen.evidence + max(ADDED, ADDED_SHARE * chosen.evidence):
                return chosen
            chosen = joined
        if len(chain) == MOST_SITES and len(family) > MOST_SITES:
            more = [*chain, self._next(chain, family)]
            gained = self.of(more, family, lively).evidence - chosen.evidence
            usual = SPREAD * chosen.evidence / len(chain)
            return replace(chosen, spread=gained >= max(ADDED, usual))
        return chosen

    def _chain(
        self, parts: Sequence[Signature], family: Sequence[Signature]
    ) -> tuple[Signature, ...]:
        """Parts, and those of a family that take most of the rest: as many as a fault may have."""
        chain = tuple(parts)
        lawless = max(part.basis.shape[1] for part in family) > MOST_FREE
        while len(chain) < (1 if lawless else min(MOST_SITES, len(family))):
            chain = (*chain, self._next(chain, family))
        return chain

    def lively(self, family: Sequence[Signature]) -> float:
        """How much larger than by the scale the squares are that a family's ordinary sites take of
        the difference, those left aside that take most: a ratio, 1 or more."""
        left, basis, others = self._without(self._chain((), family), family)
        if len(others) < FEWEST_ORDINARY or others[0].shift is not None:
            return 1.0
        taken = self._takings(others, left, basis)
        free = np.array([part.basis.shape[1] for part in others])
        scale = (_square(left) + self.wander.prior) / self.count
        share = max(ORDINARY, 1.0 - LEFT_ASIDE / len(others))
        usual = chi2.ppf(share, free) * max(scale, np.finfo(float).tiny)
        return max(1.0, float(np.quantile(taken / usual, share)))

    def elsewhere(self, chosen: Explained, family: Sequence[Signature]) -> Explained:
        """The best of a family with one of the sites chosen exchanged for another."""
        found = []
        lively = self.lively(family)
        for part in chosen.parts:
            rest = tuple(p for p in chosen.parts if p is not part)
            left = [p for p in family if p is not part]
            if len(left) > len(rest):
                found.append(self.of([*rest, self._next(rest, left)], family, lively))
        return max(found, key=lambda e: e.evidence, default=replace(chosen, evidence=-np.inf))

    def holds(self, wider: Explained, chosen: Explained) -> bool:
        """Whether one explanation can do all that another does, by freedom alone."""
        if any(part.shift is not None for part in (*wider.parts, *chosen.parts)):
            return False
        free, inner = (
            _spanned(self.wander.across(np.column_stack([p.basis for p in e.parts])), self.basis)
            for e in (wider, chosen)
        )
        return _square((inner - free @ (free.T @ inner)).ravel()) < TINY * inner.shape[1]

    def _next(self, chosen: Sequence[Signature], family: Sequence[Signature]) -> Signature:
        """The one of a family that takes most of what the chosen ones leave."""
        left, basis, others = self._without(chosen, family)
        return others[int(np.argmax(self._takings(others, left, basis)))]

    def _without(
        self, chosen: Sequence[Signature], family: Sequence[Signature]
    ) -> tuple[np.ndarray, np.ndarray, list[Signature]]:
        """What the chosen ones leave, what has been explained with them, the rest of the family."""
        left, basis = self.left, self.basis
        for part in chosen:
            left, basis, _ = self._taken(part, left, basis)
        return left, basis, [part for part in family if not any(part is c for c in chosen)]

    def _takings(
        self, others: Sequence[Signature], left: np.ndarray, basis: np.ndarray
    ) -> np.ndarray:
        """How much of the square of what is left each of others takes."""
        if any(part.shift is not None or part.basis.shape[1] != 1 for part in others):
            return np.array([self._taken(part, left, basis)[2] for part in others])
        columns = self.wander.across(np.column_stack([part.basis[:, 0] for part in others]))
        length = (columns**2).sum(axis=0)
        columns -= basis @ (basis.T @ columns)
        rest = (columns**2).sum(axis=0)
        return (left @ columns) ** 2 / np.where(rest > TINY * length, rest, np.inf)


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
