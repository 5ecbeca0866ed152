"""Whether an effect is certain: the gates that it must pass, and its values there."""

from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.estimates import Fitted, amounts, estimates
from eitskin.diagnose.fitting.family_sizes import standing_out
from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.fitting.held_out import error_units
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import (
    ACCEPTABLE,
    CULPRIT,
    DISTINCT,
    ELSEWHERE,
    NOTHING_UNNAMED,
    REMAINDER,
    SIZE_INTERVAL,
    STANDARD_ERRORS,
    STANDS_OUT,
    STATED_SIZE,
    SURE_GAIN,
    UNAFFECTED,
    Gate,
)
from eitskin.diagnose.search.prediction import acceptance_p_value
from eitskin.diagnose.search.refits import reduced
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.nothing import holds_nothing


class Judgement(NamedTuple):
    """A value held against a gate; place: the other name, where there is one."""

    gate: Gate
    value: float
    place: str = ""

    @property
    def passed(self) -> bool:
        """Whether the gate lets the value pass."""
        return self.gate.admits(self.value)


def is_certain(judgements: list[list[Judgement]]) -> bool:
    """Whether every item of `certainty` has a gate that was passed."""
    return all(any(judgement.passed for judgement in item) for item in judgements)


def certainty(diagnosis: Diagnosis, index: int) -> list[list[Judgement]]:
    """What effect `index` must pass to be certain, each item by one of its gates.

    Frames left out are predicted better with it than by the best set without it, or it stands out
    of its family; the calibrations
    and every other name are told apart from it; its size is not none, by its interval and by what
    is stated of it; the fit is acceptable, or
    what it leaves does not touch the effect; and the remainder, where there probably is one, could
    not tell it from another name and is at none of its sites.
    """
    gaps, remainder = diagnosis.gaps[index], diagnosis.remainder
    gain, error = least_gain(diagnosis, index)
    nearest = gaps[0].gap if gaps else np.inf
    culprit = standing_out(diagnosis.explanation.fit, index)
    outlying = [Judgement(CULPRIT, culprit.p_value)] if culprit is not None else []
    items = [
        [Judgement(SURE_GAIN, gain - STANDARD_ERRORS * error), *outlying],
        [Judgement(STANDS_OUT, gaps[0].snr if gaps else np.inf)],
        [Judgement(DISTINCT, nearest, gaps[0].rival if gaps else "")],
    ]
    interval = size_interval(diagnosis.explanation.fit, index)
    if interval is not None:
        items.append([Judgement(SIZE_INTERVAL, interval)])
        items.append([Judgement(STATED_SIZE, _states_something(diagnosis, index))])
    acceptance = Judgement(ACCEPTABLE, held_out_p(diagnosis))
    items.append([acceptance])
    if not acceptance.passed:
        items[-1].append(Judgement(UNAFFECTED, _unaffected_p(diagnosis, index)))
    if not NOTHING_UNNAMED.admits(remainder.probability):
        apart = min((g.gap for g in gaps if DISTINCT.admits(g.gap)), default=np.inf)
        items.append([Judgement(REMAINDER, apart - remainder.snr)])
        items.append([Judgement(ELSEWHERE, _shared_sites(diagnosis, index))])
    return items


def _shared_sites(diagnosis: Diagnosis, index: int) -> float:
    """Number of the sites of effect `index` at which the remainder is; of an effect without sites
    none."""
    effect, remainder = diagnosis.explanation.effects[index], diagnosis.remainder
    left_at = {
        "electrodes": remainder.electrodes,
        "drives": remainder.drives,
        "measures": remainder.measures,
    }
    if effect.scope == "common" or effect.kind not in left_at:
        return 0.0
    return float(len({int(site) for site in effect.site_indices} & set(left_at[effect.kind])))


def held_out_p(diagnosis: Diagnosis) -> float:
    """P-value of the chi squared of the folds left out, nothing without a name in its
    covariance."""
    named = diagnosis.named_fit
    return acceptance_p_value(named, diagnosis.prediction, diagnosis.noise.dof)


def least_gain(diagnosis: Diagnosis, index: int) -> tuple[float, float]:
    """Log density of the folds left out by which the explanation is above the best set without
    effect `index`, another name in its place too, in nats, and its standard error."""
    return min((rival.gain, rival.error) for rival in diagnosis.rivals[index])


def size_interval(fit: Fitted, index: int) -> float | None:
    """Probability of the widest interval of effect `index` that leaves out the value of no effect,
    the largest of the parameters that measure its size; None where no value turns it into nothing.

    Values of one parameter at several sites, and a size with a direction, have one interval in
    common, an ellipsoid. A combination of parameters that is stated in their place is never none.
    """
    effect, place = fit.effects[index], fit.coordinate_slice(index)
    if not effect.linear.any():
        return None
    if amounts(fit, index, estimates(fit, index)):
        return 1.0
    theta, covariance = fit.theta[place], fit.covariance[place, place]
    probabilities = []
    for key in dict.fromkeys(key for key, _ in effect.names):
        at = [i for i, (name, _) in enumerate(effect.names) if name == key and effect.linear[i]]
        if at:
            distance = theta[at] @ np.linalg.solve(covariance[np.ix_(at, at)], theta[at])
            probabilities.append(float(chi2.cdf(distance, len(at))))
    return max(probabilities)


def _states_something(diagnosis: Diagnosis, index: int) -> float:
    """1 where what diagnosis.json states of effect `index` leaves out no effect, else 0."""
    fit = diagnosis.explanation.fit
    parameters = estimates(fit, index)
    candidate = fit.effects[index]
    stated = {"name": candidate.name, "scope": candidate.scope, "parameters": parameters}
    if combined := amounts(fit, index, parameters):
        stated["amounts"] = combined
    return float(not holds_nothing(stated))


def _unaffected_p(diagnosis: Diagnosis, index: int) -> float:
    """`misfit_along` the signature of effect `index`; 0 beside another instrument than the owner's,
    which makes the readings others."""
    explanation, search = diagnosis.explanation, diagnosis.search
    if replaces_instrument(explanation.effects):
        return 0.0
    signature = _signature(diagnosis.named_fit, index, reduced(search, explanation, index))
    channels = np.broadcast_to(np.arange(signature.shape[1]), signature.shape)
    partitions = [channels]
    if diagnosis.named_fit.problem.model.press.max(initial=-1) > 0:
        partitions.append(error_units(diagnosis.recording))
    return misfit_along(signature, diagnosis.named_fit.residual, partitions)


def _signature(named: Fit, index: int, reduced_set: Explanation) -> np.ndarray:
    """(N, M): what an effect changes, whitened, beyond what all other coordinates of a fit can do;
    reduced_set: the set without it."""
    problem, place = named.problem, named.coordinate_slice(index)
    without = problem.voltage(reduced_set.fit.theta, reduced_set.effects)
    change = problem.whitening(named.voltage() - without).ravel()
    others = np.delete(named.jacobian, np.arange(place.start, place.stop), axis=0)
    columns = others.reshape(len(others), -1).T
    rest = change - columns @ np.linalg.lstsq(columns, change)[0]
    return rest.reshape(named.residual.shape)


def misfit_along(
    signature: np.ndarray, residual: np.ndarray, partitions: list[np.ndarray]
) -> float:
    """P-value of the squared length of a residual (N, M) along a signature (N, M), both whitened,
    piece by piece: what a misfit does to the size of an effect (White, Econometrica 48, 1980).

    partitions: labels (N, M) of pieces of the readings. The residual of a fit is orthogonal to the
    whole signature; its products with the pieces are independent but for that where it is noise,
    and the sum of their squares is taken to have the scaled chi squared distribution of its mean
    and variance. The smallest p-value of the partitions, times their number.
    """
    length = float((signature**2).sum())
    p_values = [1.0]
    for labels in partitions:
        label = np.unique(labels, return_inverse=True)[1].ravel()
        product = np.bincount(label, (signature * residual).ravel())
        weight = np.bincount(label, (signature**2).ravel()) / length if length else np.zeros(1)
        square = (weight**2).sum()
        mean = 1.0 - square
        variance = 2.0 * (square - 2.0 * (weight**3).sum() + square**2)
        if length and variance > 0.0 and mean > 0.0:
            dof = 2.0 * mean**2 / variance
            p_values.append(float(chi2.sf((product**2).sum() / length * dof / mean, dof)))
    return min(1.0, len(partitions) * min(p_values))
