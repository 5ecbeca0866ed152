"""What a recording can distinguish: SNR gaps between names, and what it cannot show at all.

The gap of a named effect to another name is the length, in noise units, of the part of its
signature that remains when the other has been fitted to it with site and amplitude free, the
calibrations and the other named effects following. An amplitude may be 0: no gap is larger than the
signature.
"""

from dataclasses import dataclass, replace

import numpy as np

from eitskin.diagnose.fitting.candidates import (
    Candidate,
    is_discrete,
    is_linearised,
    is_wiring_fault,
)
from eitskin.diagnose.fitting.fit import Fit, Problem, fit, rewhitened
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search import far_starts
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.search.refits import linearised, reduced
from eitskin.diagnose.search.refits import rough as rough_problem
from eitskin.diagnose.search.screen import explained_square, sparse
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.identities import is_two_sided, other_sides
from eitskin.effects.effect import Setting
from eitskin.errors import InputError

CLOSE = 6.0  # times DISTINCT: a linear gap below it may shrink to a class on the nonlinear model
MOST_FITTED = 5  # rivals of one effect, as each costs a fit on the nonlinear model
# A linear gap that is so large a share of so strong a signature is far above DISTINCT: it is not
# worth a fit, but for the nearest names.
STRONG_SNR, STRONG_SHARE, NEAREST_FITTED = 20.0, 0.2, 3


@dataclass(frozen=True)
class Gap:
    """Distance of a rival name from the signature of a named effect, and the length of that
    signature; both in noise units."""

    rival: str
    gap: float
    snr: float


def gaps(
    search: Search, explanation: Explanation, index: int, within: float = CLOSE * DISTINCT.threshold
) -> list[Gap]:
    """Gap of effect `index` of an explanation to every other name, the nearest first.

    within: the linear gap under which the nearest are fitted on the nonlinear model.
    """
    effect = explanation.effects[index]
    if is_wiring_fault(effect):
        return _gross_gaps(search, explanation, index)
    if search.starts_far(effect):
        return _gaps_afar(search, explanation, index, within)
    reduced_set = reduced(search, explanation, index)
    problem = explanation.fit.problem
    target = replace(problem, readings=explanation.fit.voltage())
    tangents = Tangents(rewhitened(reduced_set.fit, problem), [linearised(search, reduced_set)])
    signature = tangents.change(explanation.fit)
    snr = float(np.sqrt(signature @ signature))
    best: dict[str, tuple[float, Candidate]] = {}
    rivals = _rivals(search.candidates, effect)
    tangents.precompute(c for c in rivals if not is_discrete(c))
    for candidate in rivals:
        gap = _linear_gap(tangents, signature, candidate)
        if gap is not None and gap < best.get(candidate.name, (np.inf, None))[0]:
            best[candidate.name] = gap, candidate
    ranked = sorted(best.items(), key=lambda pair: pair[1][0])
    nearest: dict[str, float] = {}
    for rank, (name, (gap, candidate)) in enumerate(ranked):
        is_strong = snr > STRONG_SNR and gap > STRONG_SHARE * snr and rank >= NEAREST_FITTED
        is_near = rank < MOST_FITTED and gap < within and not is_strong
        is_near = is_near or (not DISTINCT.admits(gap) and is_two_sided(name))
        fitted = None
        # Members of families would be drawn to 0, not to where they are.
        is_near = is_near and not problem.model.families
        if is_near and candidate.size and not search.spent:
            fitted = _fitted(target, tangents, reduced_set.effects, candidate)
        if fitted is not None:
            gap = min(gap, float(np.sqrt(fitted.chi2)))
            _declare_rival(nearest, search, explanation, fitted, gap)
        nearest[name] = min(float(gap), nearest.get(name, np.inf))
    return _ranked(nearest, search, explanation, index, snr)


def _ranked(
    nearest: dict[str, float], search: Search, explanation: Explanation, index: int, snr: float
) -> list[Gap]:
    """Gaps of names, those of the effect's identities among them, the nearest first."""
    _declare(nearest, search, explanation, index, 0.0)
    nearest.pop(explanation.effects[index].name, None)
    distances = [Gap(name, min(gap, snr), snr) for name, gap in nearest.items()]
    return sorted(distances, key=lambda g: g.gap)


def _declare(
    nearest: dict[str, float], search: Search, explanation: Explanation, index: int, gap: float
) -> None:
    """Puts the other sides of an effect's identities among the nearest names; gap: that of the
    effect itself, which may exceed theirs."""
    for identity, side in other_sides(search, explanation, index):
        for name in identity.names:
            nearest[name] = min(max(gap, side.gap), nearest.get(name, np.inf))


def _declare_rival(
    nearest: dict[str, float], search: Search, explanation: Explanation, fitted: Fit, gap: float
) -> None:
    """The same of a rival, the last effect of its fit, where its gap makes it a possible cause."""
    if not DISTINCT.admits(gap) and is_two_sided(fitted.effects[-1].name):
        trial = replace(explanation, fit=fitted)
        _declare(nearest, search, trial, len(fitted.effects) - 1, gap)


def _gaps_afar(search: Search, explanation: Explanation, index: int, within: float) -> list[Gap]:
    """Of an effect that no tangent leads to: its signature is the residual of the other effects
    fitted to it, and every rival within reach is fitted too, as tangents mislead so far away.
    Rivals that cannot be fitted, or would cost bodies when no more may be solved, have no gap."""
    reduced_set, problem = reduced(search, explanation, index), explanation.fit.problem
    target = replace(problem, readings=explanation.fit.voltage())
    rough = replace(rough_problem(search, reduced_set), readings=target.readings)
    rest_fit = _best_fit(target, reduced_set)
    tangents = Tangents(rest_fit)
    snr = float(np.sqrt(rest_fit.chi2))
    best: dict[str, tuple[float, Candidate]] = {}
    for candidate in _rivals(search.candidates, explanation.effects[index]):
        if far_starts.is_far(candidate):
            if search.spent:
                continue
            misfit, _ = far_starts.start(rough, reduced_set.effects, rest_fit.theta, [candidate])
            gap: float | None = float(np.sqrt(misfit))
        else:
            gap = _linear_gap(tangents, tangents.residual, candidate)
        if gap is not None and gap < best.get(candidate.name, (np.inf,))[0]:
            best[candidate.name] = gap, candidate
    costly = search.spent and any(far_starts.is_far(effect) for effect in reduced_set.effects)
    nearest: dict[str, float] = {}
    for name, (gap, candidate) in best.items():
        if gap >= within and not far_starts.is_far(candidate):
            nearest[name] = min(float(gap), nearest.get(name, np.inf))
            continue
        fitted = None
        if far_starts.is_far(candidate):
            _, start = far_starts.start(rough, reduced_set.effects, rest_fit.theta, [candidate])
            fitted = _fitted_from(target, rough, [*reduced_set.effects, candidate], start)
        elif not costly:
            fitted = _fitted(target, tangents, reduced_set.effects, candidate)
        if fitted is not None:
            gap = float(np.sqrt(fitted.chi2))
            _declare_rival(nearest, search, explanation, fitted, gap)
            nearest[name] = min(gap, nearest.get(name, np.inf))
    return _ranked(nearest, search, explanation, index, snr)


def _best_fit(target: Problem, reduced_set: Explanation) -> Fit:
    """The effects of a set fitted to a signature from their coordinates and, where the physics has
    such a skin, from the beliefs."""
    start = reduced_set.fit.theta
    continued = fit(target, reduced_set.effects, start, polish=True)
    try:
        restarted = fit(target, reduced_set.effects, np.zeros_like(start), polish=True)
    except InputError:
        return continued
    return min(continued, restarted, key=lambda fitted: fitted.chi2)


def _fitted_from(
    target: Problem, rough: Problem, effects: list[Candidate], theta: np.ndarray
) -> Fit | None:
    """Effects fitted from afar: roughly, then to the noise-free signature; None where they cannot
    be."""
    try:
        theta = fit(rough, effects, theta, polish=True).theta
        return fit(target, effects, theta)
    except (InputError, np.linalg.LinAlgError):
        return None


def _rivals(candidates: list[Candidate], effect: Candidate) -> list[Candidate]:
    """Other names at one site, or with the scope of the effect, or in its channels: more freedom
    than the effect has would fit anything."""
    rivals = []
    for candidate in candidates:
        if candidate.name == effect.name or candidate.effect.tone:
            continue
        if candidate.kind == "channels":
            if effect.kind == "channels":
                is_dense = effect.scope == "dense"
                rivals.append(candidate if is_dense else sparse(candidate, effect.site_indices))
        elif candidate.scope != "dense" or effect.scope == "dense":
            rivals.append(candidate)
    return rivals


def _linear_gap(tangents: Tangents, signature: np.ndarray, candidate: Candidate) -> float | None:
    if is_discrete(candidate):
        change = tangents.start_change(candidate)
        if change is None:
            return None
        residual = signature - change
        return float(np.sqrt(min(residual @ residual, signature @ signature)))
    columns = tangents.columns(candidate)
    if not len(columns):
        return None
    gain, _ = explained_square(columns, signature)
    return float(np.sqrt(max(float(signature @ signature) - gain, 0.0)))


def _fitted(
    target: Problem, tangents: Tangents, effects: list[Candidate], candidate: Candidate
) -> Fit | None:
    """The rival fitted on the nonlinear model to the noise-free signature; None where it cannot
    be."""
    start = np.r_[tangents.fit.theta, np.zeros(candidate.size)]
    jacobian = np.concatenate([tangents.fit.jacobian, tangents.jacobian(candidate)])
    try:
        return fit(target, [*effects, candidate], start, jacobian)
    except (InputError, np.linalg.LinAlgError):
        return None


def _gross_gaps(search: Search, explanation: Explanation, index: int) -> list[Gap]:
    """Of a gross fault: to the other gross faults in its place, and to nothing."""
    model, whitening = search.problem.model, explanation.fit.problem.whitening
    calibration = explanation.fit.theta[: len(model.calibrations)]
    simulated = explanation.fit.voltage()
    remaining = [s for i, s in enumerate(explanation.fit.settings()) if i != index]

    def gap_of(settings: list[Setting]) -> float:
        change = whitening(model.voltage(calibration, settings) - simulated)
        return float(np.sqrt((change**2).sum()))

    snr = gap_of(remaining)
    best: dict[str, float] = {}
    for candidate in search.candidates:
        if is_wiring_fault(candidate) and candidate.name != explanation.effects[index].name:
            gap = gap_of([*remaining, candidate.setting(np.zeros(candidate.size))])
            best[candidate.name] = min(gap, best.get(candidate.name, snr))
    return sorted((Gap(n, g, snr) for n, g in best.items()), key=lambda g: g.gap)


def strengths(search: Search, explanation: Explanation) -> dict[str, float]:
    """SNR of every name at a typical size, at the site where it shows best, the fitted directions
    projected out; 0 of names that change nothing in these readings."""
    tangents = linearised(search, explanation)
    tangents.precompute(c for c in search.candidates if is_linearised(c) and c.scope != "dense")
    snrs: dict[str, float] = {}
    for candidate in search.candidates:
        if candidate.effect.tone:
            snr = np.inf if search.problem.model.frame_s else 0.0
        elif candidate.kind == "channels":
            snr = np.inf if candidate.kind == candidate.effect.sites[0] else 0.0
        elif is_wiring_fault(candidate):
            snr = np.inf
        elif candidate.scope == "dense" or is_discrete(candidate):
            continue
        else:
            columns = tangents.coordinate_columns(candidate)
            snr = max((float(np.linalg.norm(c)) for c in columns if c is not None), default=0.0)
        snrs[candidate.name] = max(snrs.get(candidate.name, 0.0), snr)
    return snrs
