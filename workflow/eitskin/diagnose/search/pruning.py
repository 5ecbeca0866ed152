"""Effects that do not earn their place on folds left out, taken out one by one."""

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, replaces_instrument
from eitskin.diagnose.fitting.estimates import range_share
from eitskin.diagnose.fitting.family_sizes import standing_out
from eitskin.diagnose.fitting.fit import rewhitened
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.fitting.held_out import gain_over_presses, held_out
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.families import grown_with_members
from eitskin.diagnose.search.gates import (
    ACCEPTABLE,
    CULPRIT,
    FAMILIES_PREDICT,
    FOLDS,
    HARM_ERRORS,
    HARM_RATIO,
    PRESSES,
    RANGE,
    STANDARD_ERRORS,
)
from eitskin.diagnose.search.growth import Outcome
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.prediction import (
    acceptance_p_value,
    is_gross,
    named_prediction,
    predicted,
)
from eitskin.diagnose.search.refits import named_fit, reduced, settled
from eitskin.diagnose.search.search import Search


def pruned(outcome: Outcome, units: np.ndarray, noise_dof: float) -> Outcome:
    """An outcome of a search less the effects that do not earn their place; where that was a last
    resort, the explanation before it, judged in the noise before it. Where families do not predict
    a gross misfit, nothing is explained.

    units (N, M): labels of independent units of the recording (`held_out.error_units`); noise_dof:
    degrees of freedom of the noise's scale.
    """
    search, calibration, after = outcome
    was_replaced = replaces_instrument(after.effects)
    search, after = settled(search, after)
    unnamed = search, calibration, calibration
    in_noise, calibration, after = grown_with_members((search, calibration, after))
    after = _earning(in_noise, after, units, noise_dof)
    if in_noise is not search and not _predicts_misfit(in_noise, calibration, after):
        search.report("families do not predict what is left out: nothing is explained")
        return unnamed
    if was_replaced and not replaces_instrument(after.effects):
        in_noise = in_noise.restored()
        after = _earning(in_noise, calibration, units, noise_dof)
    return in_noise, calibration, after


def _predicts_misfit(search: Search, calibration: Explanation, explanation: Explanation) -> bool:
    """Whether an explanation with families leaves no gross misfit, or predicts most of the misfit
    of the folds left out that the calibrations leave."""
    if not is_gross(search, explanation):
        return True
    named = named_fit(explanation)
    before = held_out(rewhitened(calibration.fit, named.problem), search.folds)
    share = named_prediction(explanation, named).rms ** 2 / before.rms**2
    return FAMILIES_PREDICT.admits(share)


def _earning(
    search: Search, explanation: Explanation, units: np.ndarray, noise_dof: float
) -> Explanation:
    """An explanation less the effects that do not earn their place, the worst first."""
    while explanation.effects:
        search.journal.begin_round()
        named = named_fit(explanation)
        prediction = named_prediction(explanation, named)
        is_accepted = ACCEPTABLE.admits(acceptance_p_value(named, prediction, noise_dof))
        weakest, lowest = None, 0.0
        for index in range(len(explanation.effects)):
            worth = _worth(search, explanation, index, units, is_accepted)
            if worth < lowest:
                weakest, lowest = index, worth
        if weakest is None:
            break
        search.journal.step("not earned", explanation.effects[weakest], explanation)
        explanation = reduced(search, explanation, weakest)
    return explanation


def _worth(
    search: Search, explanation: Explanation, index: int, units: np.ndarray, is_accepted: bool
) -> float:
    """The least of the values at which effect `index` is refused, nats, 0 where it is not; minus
    infinity where it does harm, and where its size may be any.

    Harm is a growth of the rms error or a number of standard errors; both at once where the
    covariance accepts what is left, as it says that places and forces are off by so much. Each fit
    predicts in a covariance of its own then: another one moves it.
    """
    effect, problem = explanation.effects[index], explanation.fit.problem
    reduced_set, judge = reduced(search, explanation, index), search.journal.judge
    culprit = standing_out(explanation.fit, index)
    if culprit is not None and CULPRIT.admits(culprit.p_value):
        judge(CULPRIT, culprit.p_value, effect, reduced_set)
        return 0.0
    rival = predicted(search, reduced_set, explanation)
    gain, error = explanation.held_out.gain(rival)
    mask, model = problem.whitening.mask, problem.model
    pressed = model.touched & model.simulable & mask.any(axis=1)
    over_presses = gain_over_presses(explanation.held_out, rival, units[:, 0], pressed)
    values = [(FOLDS, gain - STANDARD_ERRORS * error), (PRESSES, over_presses)]
    worth = min((v for gate, v in values if not judge(gate, v, effect, reduced_set)), default=0.0)
    errors = explanation.held_out.residual, reduced_set.held_out.residual
    comparison = harm(*errors, np.where(mask, 0.0, np.nan), units)
    is_harmless = _is_harmless(search.journal, effect, reduced_set, comparison, is_accepted)
    is_sized = judge(RANGE, range_share(explanation.fit, index), effect, reduced_set)
    return worth if is_harmless and is_sized else -np.inf


def _is_harmless(
    journal: Journal,
    effect: Candidate,
    reduced_set: Explanation,
    comparison: dict[str, float],
    is_accepted: bool,
) -> bool:
    """Whether an effect does no harm beside the rest; comparison: as of `harm`, of the errors with
    it and without it."""
    rms, rms_without = comparison["rmse_V"], comparison["rmse_before_V"]
    errors = comparison["standard_errors"]
    ratio = rms / rms_without if rms_without else (np.inf if rms else 1.0)
    values = [(HARM_RATIO, ratio), (HARM_ERRORS, 0.0 if np.isnan(errors) else errors)]
    if is_accepted:
        return journal.judge_any(values, effect, reduced_set)
    return all([journal.judge(gate, value, effect, reduced_set) for gate, value in values])
