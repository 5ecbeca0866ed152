"""Which fault explains the change between two sessions, and how much better than any other.

The evidence for a fault, in nats, is the log likelihood ratio of the change with and without it,
its free sizes at their best and the scale of the wander unknown but for the scatter within
sessions, less half the log number of values for each free size (Schwarz 1978) and the log number of
sites that it may have. Where the ordinary sites of a family scatter more than the scale says, a
site must stand out beside these. Constants were set on the development block of
docs/concealed/pairs.md.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import comb, log

import numpy as np
from scipy.stats import chi2

from eitskin.diagnose.compare.faults import Signature
from eitskin.diagnose.compare.wander import Wander

MOST_SITES = 3  # of one fault
MOST_FREE_SIZES = 8  # of a site with which unchanged may be: more explain anything
SITE_NATS = 6.0  # that one more site must bring
SITE_SHARE = 0.05  # the same, as a share of the evidence of the sites before it
WIDESPREAD_SHARE = 0.3  # of the mean evidence of a site: a fourth that brings it shows no end
ORDINARY_SHARE = 0.8  # of a family's other sites, beside which one must stand out,
MOST_EXTRAORDINARY = 3  # or all but so many, where that is more
FEWEST_ORDINARY = 4  # sites of which a quantile tells anything
NEGLIGIBLE = 1e-6  # of a signature's square: a rest below it is rounding


@dataclass(frozen=True)
class Explanation:
    """Signatures of one kind of fault, one a site, and their evidence in nats.

    widespread: whether yet more sites would add to it, so that it is no fault of a few.
    """

    signatures: tuple[Signature, ...]
    evidence: float
    widespread: bool = False

    @property
    def name(self) -> str:
        """The fault's name."""
        return self.signatures[0].name

    @property
    def place(self) -> tuple[str | None, tuple[int, ...]]:
        """Kind and numbers of the sites."""
        sites = (site for signature in self.signatures for site in signature.sites)
        return self.signatures[0].kind, tuple(sorted(sites))


class Evidence:
    """The whitened change of two sessions beside what signatures named already explain of it.

    residual (M,): what they leave; basis (M, k): orthonormal, of what they explain; dof: values of
    the change and prior degrees of freedom of its scale; square: of the residual.
    """

    def __init__(self, wander: Wander, named_signatures: Iterable[Signature] = ()):
        self.wander = wander
        self.residual = wander.whitened(wander.change)
        self.basis = np.zeros((len(self.residual), 0))
        for signature in named_signatures:
            self.residual, self.basis, _ = self._removed(signature, self.residual, self.basis)
        self.dof = wander.dof - self.basis.shape[1] + wander.prior_dof
        self.square = _square(self.residual)

    def _removed(
        self, signature: Signature, residual: np.ndarray, basis: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Residual and basis with one signature more, and how much of the square it explains."""
        gain = 0.0
        if signature.shift is not None:
            shift = self.wander.whitened(signature.shift)
            shifted = residual - (shift - basis @ (basis.T @ shift))
            gain, residual = _square(residual) - _square(shifted), shifted
        if signature.basis.shape[1]:
            free = _complement(self.wander.whitened(signature.basis), basis)
            sizes = free.T @ residual
            gain += _square(sizes)
            residual = residual - free @ sizes
            basis = np.column_stack([basis, free])
        return residual, basis, gain

    def explanation(
        self, signatures: Sequence[Signature], family: Sequence[Signature], inflation: float = 1.0
    ) -> Explanation:
        """Signatures of a family with their evidence, its scale inflated as by `inflation`."""
        residual, basis, gain = self.residual, self.basis, 0.0
        for signature in signatures:
            residual, basis, more = self._removed(signature, residual, basis)
            gain += more
        free_sizes = basis.shape[1] - self.basis.shape[1]
        extraordinary = 0.0
        if inflation > 1.0:
            for signature in self._extended(signatures, family)[len(signatures) :]:
                residual, basis, more = self._removed(signature, residual, basis)
                extraordinary += more
        prior = self.wander.prior_dof or max(NEGLIGIBLE * self.square, np.finfo(float).tiny)
        after = inflation * (_square(residual) + prior)
        ratio = (after + max(gain, 0.0) + extraordinary) / (after + extraordinary)
        nats = 0.5 * self.dof * log(ratio) - 0.5 * free_sizes * log(self.dof)
        return Explanation(tuple(signatures), nats - log(comb(len(family), len(signatures))))

    def best(self, family: Sequence[Signature]) -> Explanation:
        """The best explanation of a family, with more sites as long as each brings enough."""
        inflation = self.inflation(family)
        ranked = self._extended((), family)
        best = self.explanation(ranked[:1], family, inflation)
        for count in range(2, len(ranked) + 1):
            wider = self.explanation(ranked[:count], family, inflation)
            if wider.evidence < best.evidence + max(SITE_NATS, SITE_SHARE * best.evidence):
                return best
            best = wider
        if len(ranked) == MOST_SITES and len(family) > MOST_SITES:
            wider = self.explanation([*ranked, self._strongest(ranked, family)], family, inflation)
            gain = wider.evidence - best.evidence
            usual = WIDESPREAD_SHARE * best.evidence / len(ranked)
            return replace(best, widespread=gain >= max(SITE_NATS, usual))
        return best

    def _extended(
        self, signatures: Sequence[Signature], family: Sequence[Signature]
    ) -> tuple[Signature, ...]:
        """Signatures and those of a family that explain most of their residual, as many as a fault
        may have sites."""
        extended = tuple(signatures)
        lawless = max(member.basis.shape[1] for member in family) > MOST_FREE_SIZES
        while len(extended) < (1 if lawless else min(MOST_SITES, len(family))):
            extended = (*extended, self._strongest(extended, family))
        return extended

    def inflation(self, family: Sequence[Signature]) -> float:
        """The ratio, 1 or more, of the square that the ordinary sites of a family explain to that
        by the scale; the strongest sites are left out."""
        residual, basis, members = self._remaining(self._extended((), family), family)
        if len(members) < FEWEST_ORDINARY or members[0].shift is not None:
            return 1.0
        gains = self._gains(members, residual, basis)
        free_sizes = np.array([member.basis.shape[1] for member in members])
        variance = (_square(residual) + self.wander.prior_dof) / self.dof
        share = max(ORDINARY_SHARE, 1.0 - MOST_EXTRAORDINARY / len(members))
        usual = chi2.ppf(share, free_sizes) * max(variance, np.finfo(float).tiny)
        return max(1.0, float(np.quantile(gains / usual, share)))

    def best_elsewhere(self, explanation: Explanation, family: Sequence[Signature]) -> Explanation:
        """The best explanation of a family with one of the sites exchanged for another."""
        rivals = []
        inflation = self.inflation(family)
        for signature in explanation.signatures:
            unchanged = tuple(s for s in explanation.signatures if s is not signature)
            members = [member for member in family if member is not signature]
            if len(members) > len(unchanged):
                exchanged = [*unchanged, self._strongest(unchanged, members)]
                rivals.append(self.explanation(exchanged, family, inflation))
        nothing = replace(explanation, evidence=-np.inf)
        return max(rivals, key=lambda rival: rival.evidence, default=nothing)

    def contains(self, wider: Explanation, narrower: Explanation) -> bool:
        """Whether the free sizes of one explanation can do all that those of another do."""
        if any(s.shift is not None for s in (*wider.signatures, *narrower.signatures)):
            return False
        outer, inner = (
            _complement(
                self.wander.whitened(np.column_stack([s.basis for s in explanation.signatures])),
                self.basis,
            )
            for explanation in (wider, narrower)
        )
        outside = inner - outer @ (outer.T @ inner)
        return _square(outside.ravel()) < NEGLIGIBLE * inner.shape[1]

    def _strongest(self, signatures: Sequence[Signature], family: Sequence[Signature]) -> Signature:
        """The member of a family that explains most of the residual of signatures."""
        residual, basis, members = self._remaining(signatures, family)
        return members[int(np.argmax(self._gains(members, residual, basis)))]

    def _remaining(
        self, signatures: Sequence[Signature], family: Sequence[Signature]
    ) -> tuple[np.ndarray, np.ndarray, list[Signature]]:
        """Residual and basis with signatures, and the members of the family beside them."""
        residual, basis = self.residual, self.basis
        for signature in signatures:
            residual, basis, _ = self._removed(signature, residual, basis)
        members = [m for m in family if not any(m is signature for signature in signatures)]
        return residual, basis, members

    def _gains(
        self, members: Sequence[Signature], residual: np.ndarray, basis: np.ndarray
    ) -> np.ndarray:
        """How much of the residual's square each member explains by itself."""
        if any(member.shift is not None or member.basis.shape[1] != 1 for member in members):
            return np.array([self._removed(member, residual, basis)[2] for member in members])
        columns = self.wander.whitened(np.column_stack([m.basis[:, 0] for m in members]))
        square = (columns**2).sum(axis=0)
        columns -= basis @ (basis.T @ columns)
        free_square = (columns**2).sum(axis=0)
        return (residual @ columns) ** 2 / np.where(
            free_square > NEGLIGIBLE * square, free_square, np.inf
        )


def _square(values: np.ndarray) -> float:
    return float(values @ values)


def _complement(columns: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the part of columns that lies outside another basis."""
    length = np.sqrt((columns**2).sum(axis=0))
    columns = columns[:, length > 0] / length[length > 0]
    outside = columns - basis @ (basis.T @ columns)
    eigenvalues, eigenvectors = np.linalg.eigh(outside.T @ outside)
    positive = eigenvalues > NEGLIGIBLE
    return outside @ (eigenvectors[:, positive] / np.sqrt(eigenvalues[positive]))
