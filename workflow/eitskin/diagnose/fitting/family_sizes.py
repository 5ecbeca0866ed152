"""The sds of families about a fit that has their members as coordinates.

About the fit the readings are linear in its P coordinates theta, of prior variances v: with
whitened slopes J (P, N M) and y = r + J^T theta, r the whitened residual, the marginal likelihood
is

    log L(v) = -1/2 [log det(I + D G D) + y^T y - b^T D (I + D G D)^-1 D b],

D = diag(v)^(1/2), G = J J^T, b = J y: that of a linear mixed model (Harville, JASA 72, 1977). Sizes
are those of the greatest likelihood under half-normal priors of one typical change.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm

from eitskin.diagnose.fitting.families import family_name
from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.fitting.simulator import Member
from eitskin.diagnose.noise.components import COMPONENTS

MOST_GROWTH = 100.0  # times its sd, that a family may be learned to have
APART = "apart"  # the first word of the name of a member that is apart from its family
LEAST_DEVIATION = 1.5  # sds of its family, from which on a member may be apart
OUTLYING = 8.4  # nats: of 37 names one, of six sizes of an effect one, and strong evidence, 3
STEP = 1e-3  # of the logarithm of a size, for its likelihood's curvature
LARGEST_LOG_SD = 2.0  # of a direction of sizes: by then an interval spans a factor of 700
ABSENT = 1e-3  # of its prior's sd: a family that is smaller does nothing


@dataclass(frozen=True)
class FamilySizes:
    """The marginal likelihood of the sds of K families about a fit.

    names: of the families; sds (K,): that the fit has, in typical changes; label (P,): the family
    of each coordinate, -1 for none; variance (P,): of the coordinates' priors at these sds; gram
    (P, P) and products (P,): G and b.
    """

    names: list[str]
    sds: np.ndarray
    label: np.ndarray
    variance: np.ndarray
    gram: np.ndarray
    products: np.ndarray

    @classmethod
    def from_fit(cls, fit: Fit) -> "FamilySizes":
        """About a fit whose simulator has families."""
        model = fit.problem.model
        member_names = [family_name(c) for c in model.families for _ in range(c.size)]
        names = list(dict.fromkeys(member_names))
        label = np.full(len(fit.theta), -1)
        members = [i for i, item in enumerate(model.calibrations) if isinstance(item, Member)]
        label[members] = [names.index(name) for name in member_names]
        sds = [model.calibrations[members[member_names.index(name)]].sd for name in names]
        gram = fit.information
        products = fit.slopes.products_with(fit.residual) + gram @ fit.theta
        return cls(names, np.array(sds), label, 1.0 / fit.prior, gram, products)

    def log_likelihood(self, sds: np.ndarray) -> tuple[float, np.ndarray]:
        """Of sds (K,), with their priors, up to a constant; and its derivatives (K,) by their
        logarithms: by x = (I + D G D)^-1 D b, the coordinates in sds of their priors, the sum of
        x^2 over a family less the number of its coordinates that the readings determine."""
        root, matrix = self._standardised(sds)
        inverse, scaled = np.linalg.inv(matrix), root * self.products
        x = inverse @ scaled
        prior = (sds / self._prior_sds()) ** 2
        excess = x**2 - (1.0 - np.diag(inverse))
        slopes = np.array([excess[self.label == k].sum() for k in range(len(sds))]) - prior
        likelihood = 0.5 * (scaled @ x - np.linalg.slogdet(matrix)[1] - prior.sum())
        return float(likelihood), slopes

    def greatest(self, absent: Collection[str] = ()) -> tuple[np.ndarray, float]:
        """The sds (K,) of the greatest likelihood, and that; absent: families whose sd is 0."""
        present = np.array([name not in absent for name in self.names])

        def cost(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
            likelihood, slopes = self.log_likelihood(present * np.exp(logarithms) * self.sds)
            return -likelihood, -slopes * present

        largest = [COMPONENTS[n].largest if n in COMPONENTS else np.inf for n in self.names]
        most = np.clip(largest / self.sds, 1.0, MOST_GROWTH)
        start, bounds = np.zeros(len(present)), [(np.log(ABSENT), np.log(m)) for m in most]
        best = minimize(cost, start, method="L-BFGS-B", jac=True, bounds=bounds)
        ratio = present * np.exp(best.x)
        ratio[ratio < 2.0 * ABSENT] = 0.0
        return ratio * self.sds, -float(best.fun)

    def log_size_sds(self, sds: np.ndarray) -> np.ndarray:
        """(K,): sds of the logarithms of the sizes at those of the greatest likelihood, by its
        curvature, what a family may take from another included; infinite where a size is 0."""
        present = np.flatnonzero(sds > 0.0)
        steps = STEP * np.eye(len(sds))[present]
        slopes = [
            self.log_likelihood(sds * np.exp(sign * step))[1][present]
            for step in steps
            for sign in (1.0, -1.0)
        ]
        curvature = (np.array(slopes[1::2]) - np.array(slopes[::2])) / (2.0 * STEP)
        values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
        variance = (vectors**2 / np.maximum(values, LARGEST_LOG_SD**-2)).sum(axis=1)
        log_sds = np.full(len(sds), np.inf)
        log_sds[present] = np.sqrt(variance)
        return log_sds

    def _prior_sds(self) -> np.ndarray:
        """(K,): sds of the sizes' priors, none of a member of its own."""
        return np.array([COMPONENTS[n].prior_sd if n in COMPONENTS else np.inf for n in self.names])

    def apart(self, coordinate: int) -> "FamilySizes":
        """With one member, by its coordinate, apart from its family: of a size of its own."""
        label = self.label.copy()
        family, label[coordinate] = label[coordinate], len(self.names)
        names = [*self.names, f"{APART} {coordinate}"]
        return replace(self, names=names, sds=np.append(self.sds, self.sds[family]), label=label)

    def outlying(self, coordinates: Collection[int]) -> dict[int, float]:
        """Members among some coordinates that are likelier apart from their families, of which they
        would make the size: by coordinate the nats by which they are. As long as these are more
        than OUTLYING and the choice among the family's members cost, the likeliest first (a spike
        beside a slab: Mitchell, Beauchamp, JASA 83, 1988)."""
        sizes: FamilySizes = self
        nats: dict[int, float] = {}
        while True:
            sds, likelihood = sizes.greatest()
            root, matrix = sizes._standardised(sds)
            deviation = np.abs(np.linalg.solve(matrix, root * sizes.products))
            raised = {
                i: sizes.apart(i).greatest()[1] - likelihood
                for i in coordinates
                if i not in nats and deviation[i] > LEAST_DEVIATION
            }
            best = max(raised, key=lambda i: raised[i], default=-1)
            choices = int((self.label == self.label[best]).sum())
            if best < 0 or raised[best] < OUTLYING + np.log(choices):
                return nats
            nats[best], sizes = raised[best], sizes.apart(best)

    def _standardised(self, sds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """D's diagonal (P,) and I + D G D (P, P) at sds (K,)."""
        root = np.sqrt(self.variance) * np.r_[sds / self.sds, 1.0][self.label]
        return root, np.eye(len(root)) + root[:, None] * self.gram * root


class StandingOut(NamedTuple):
    """How far an effect at sites of a family is out of it: deviation over the family's sd, of
    several sites the least; and the probability of one so far out among all its sites."""

    ratio: float
    p_value: float


def standing_out(fit: Fit, index: int) -> StandingOut | None:
    """How far effect `index` of a fit stands out of the family of its name, whose sd was learned
    beside it; None where there is no such family.

    What is predicted of a member by all others is its prior, of the family's sd (node splitting:
    Dias et al., Statistics in Medicine 29, 2010).
    """
    effect, model = fit.effects[index], fit.problem.model
    for family, members in model.family_slices:
        if family.sites and (family.name, family.kind) == (effect.name, effect.kind):
            sd = model.calibrations[members.start].sd
            place = fit.coordinate_slice(index)
            spread = np.hypot(sd, np.sqrt(np.diag(fit.covariance)[place]))
            deviation = np.abs(fit.theta[place])
            p_values = 2.0 * norm.sf(deviation / spread) * len(family.sites)
            return StandingOut(float((deviation / sd).min()), min(1.0, float(p_values.max())))
    return None
