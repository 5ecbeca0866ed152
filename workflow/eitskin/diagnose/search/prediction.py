"""How well explanations agree with a recording: misfit, correlation, predictions of folds."""

from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.fit import Fit, rewhitened
from eitskin.diagnose.fitting.held_out import CrossValidation, HeldOut, held_out
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import GROSS_MISFIT, STANDARD_ERRORS, UNLIKE
from eitskin.diagnose.search.search import Search


def misfit(search: Search, explanation: Explanation) -> float:
    """Chi squared over its degrees of freedom in the covariance of noise alone."""
    whitening = search.problem.whitening
    residual = explanation.fit.problem.whitening.unwhitened(explanation.fit.residual)
    dof = max(whitening.size - len(explanation.fit.theta), 1)
    return float((whitening(residual) ** 2).sum()) / dof


def is_gross(search: Search, explanation: Explanation) -> bool:
    """Whether the misfit is plain to see: calibrations and tangents are led astray."""
    return GROSS_MISFIT.admits(misfit(search, explanation))


def likeness(search: Search, explanation: Explanation) -> float:
    """Squared correlation of the readings with what is simulated; below 0 where the correlation is
    negative. In the readings' unit: noise that grows with the reading would weigh the smallest, of
    which a simulation is surest to err, like the largest."""
    mask = search.problem.whitening.mask
    simulated, recorded = (
        voltage[mask] for voltage in (explanation.fit.voltage(), search.problem.readings)
    )
    simulated, recorded = simulated - simulated.mean(), recorded - recorded.mean()
    lengths = float((simulated @ simulated) * (recorded @ recorded))
    product = float(simulated @ recorded)
    return product * abs(product) / max(lengths, 1e-300)


def is_unlike(search: Search, explanation: Explanation) -> bool:
    """Whether readings are not those of a skin like this: in an order of their own, or none.
    Effects fitted to them would be no findings, were they ever so significant."""
    return is_gross(search, explanation) and UNLIKE.admits(likeness(search, explanation))


def predicted(search: Search, explanation: Explanation, trial: Explanation) -> HeldOut:
    """What an explanation predicts for the folds left out, in the covariance of a trial."""
    return held_out(rewhitened(explanation.fit, trial.fit.problem), search.folds)


def gain(search: Search, trial: Explanation, explanation: Explanation) -> tuple[float, float]:
    """Log density of the folds left out that a trial has above an explanation, in nats, and its
    standard error; both in the trial's covariance."""
    return trial.held_out.gain(predicted(search, explanation, trial))


def sure_gain(search: Search, trial: Explanation, explanation: Explanation) -> float:
    """`gain` less STANDARD_ERRORS standard errors, nats."""
    nats, error = gain(search, trial, explanation)
    return nats - STANDARD_ERRORS * error


def named_prediction(explanation: Explanation, named: Fit) -> CrossValidation:
    """What an explanation predicts for the folds left out, in the covariance of `named`, its fit
    with no discrepancy (`refits.named_fit`)."""
    if named is explanation.fit:
        return explanation.held_out
    return held_out(named, explanation.folds)


def acceptance_p_value(named: Fit, prediction: CrossValidation, noise_dof: float) -> float:
    """P-value of the chi squared of the folds left out, by the `named_prediction` of a fit; 0 with
    another instrument than the owner's, whose coordinates can explain any misfit. noise_dof: of the
    noise's scale."""
    return 0.0 if replaces_instrument(named.effects) else prediction.p_value(noise_dof)


def cost_for(explanation: Explanation, log_evidence: float) -> float:
    """Largest cost of a fit in the covariance of an explanation that may still reach a log
    evidence."""
    return -2.0 * (log_evidence - explanation.log_likelihood) + explanation.fit.chi2
