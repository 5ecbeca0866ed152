"""Effects that do not earn their place on readings that no fit has seen, taken out one by one."""

from collections.abc import Callable, Mapping

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, replaces_instrument
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import (
    ACCEPTABLE,
    FOLDS,
    HARM_ERRORS,
    HARM_RATIO,
    PRESSES,
    RESERVED,
    STANDARD_ERRORS,
)
from eitskin.diagnose.search.growth import Outcome
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.prediction import predicted
from eitskin.diagnose.search.refits import reduced, settled, without_discrepancy
from eitskin.diagnose.search.search import Search


def pruned(
    outcome: Outcome, reserve_of: Callable[[Mapping[str, float]], Reserve], noise_dof: float
) -> tuple[Outcome, Reserve]:
    """An outcome of a search less the effects that do not earn their place; where that was a last
    resort, the explanation before it, judged in the noise before it.

    reserve_of: the reserve, of sds of the rig's errors; noise_dof: of the noise's scale.
    """
    search, calibration, after = outcome
    was_replaced = replaces_instrument(after.effects)
    in_noise, after = settled(search, after)
    after, reserve = _earning(in_noise, after, reserve_of, noise_dof)
    if was_replaced and not replaces_instrument(after.effects):
        in_noise = in_noise.restored()
        after, reserve = _earning(in_noise, calibration, reserve_of, noise_dof)
    return (in_noise, calibration, after), reserve


def _earning(
    search: Search,
    explanation: Explanation,
    reserve_of: Callable[[Mapping[str, float]], Reserve],
    noise_dof: float,
) -> tuple[Explanation, Reserve]:
    """An explanation less the effects that do not earn their place, the worst first, and the
    reserve in its covariance."""
    while True:
        search.journal.begin_round()
        reserve = reserve_of(explanation.error_sds)
        plain = without_discrepancy(explanation, explanation.fit)
        is_accepted = ACCEPTABLE.admits(reserve.p_value(plain, noise_dof))
        weakest, lowest = None, 0.0
        for index in range(len(explanation.effects)):
            worth = _worth(search, explanation, index, reserve, is_accepted)
            if worth < lowest:
                weakest, lowest = index, worth
        if weakest is None:
            return explanation, reserve
        search.journal.step("not earned", explanation.effects[weakest], explanation)
        explanation = reduced(search, explanation, weakest)


def _worth(
    search: Search, explanation: Explanation, index: int, reserve: Reserve, is_accepted: bool
) -> float:
    """The least of the values at which effect `index` is refused, nats, 0 where it is not; minus
    infinity where it does harm.

    Harm is a growth of the rms error or a number of standard errors; both at once where the
    covariance accepts what is left, as it says that places and forces are off by so much. Each fit
    predicts in a covariance of its own then: another one moves it.
    """
    effect = explanation.effects[index]
    reduced_set = reduced(search, explanation, index)
    gain, error = reserve.gain(explanation.fit, reduced_set.fit)
    margin = STANDARD_ERRORS * error if effect.scope == "dense" else 0.0
    folds = explanation.held_out, predicted(search, reduced_set, explanation)
    folds_gain, folds_error = folds[0].gain(folds[1])
    values = [
        (RESERVED, gain - margin),
        (FOLDS, folds_gain - STANDARD_ERRORS * folds_error),
        (PRESSES, reserve.gain_over_presses(explanation.fit, reduced_set.fit, folds)),
    ]
    judge = search.journal.judge
    worth = min((v for gate, v in values if not judge(gate, v, effect, reduced_set)), default=0.0)
    harm = reserve.harm(
        explanation.fit, reduced_set.fit, (explanation.held_out, reduced_set.held_out)
    )
    return (
        worth if _is_harmless(search.journal, effect, reduced_set, harm, is_accepted) else -np.inf
    )


def _is_harmless(
    journal: Journal,
    effect: Candidate,
    reduced_set: Explanation,
    harm: tuple[float, float, float],
    is_accepted: bool,
) -> bool:
    """Whether an effect does no harm beside the rest; harm: rms error with it and without it, and
    standard errors (`Reserve.harm`)."""
    rms, rms_without, errors = harm
    ratio = rms / rms_without if rms_without else (np.inf if rms else 1.0)
    values = [(HARM_RATIO, ratio), (HARM_ERRORS, 0.0 if np.isnan(errors) else errors)]
    if is_accepted:
        return journal.judge_any(values, effect, reduced_set)
    return all([journal.judge(gate, value, effect, reduced_set) for gate, value in values])
