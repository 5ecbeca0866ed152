"""What a recording can tell apart: SNR gaps between names, and what it cannot show at all.

The gap of a found effect to another name is the length, in noise units, of what is left of its
signature once the other has been fitted to it with site and amplitude free, calibrations and the
other found effects following. An amplitude may be 0: no gap is larger than the signature.
"""

from dataclasses import dataclass, replace

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, discrete, gross, of_tangents
from eitskin.diagnose.fitting.fit import Fit, Problem, fit, whitened_anew
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search import far_starts
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.search.refits import linearised, reduced
from eitskin.diagnose.search.refits import rough as rough_problem
from eitskin.diagnose.search.screen import explained, sparse
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.identities import is_two_sided, other_sides
from eitskin.errors import InputError

CLOSE = 6.0  # a linear gap, times this, under which the rival is fitted on the nonlinear model
MOST_FITTED = 5


@dataclass(frozen=True)
class Gap:
    """A rival name's distance from a found effect's signature; snr: the signature's own length."""

    rival: str
    gap: float
    snr: float


def gaps(
    search: Search, state: Explanation, index: int, within: float = CLOSE * DISTINCT.threshold
) -> list[Gap]:
    """Gap of effect `index` of a state to every other name, the nearest first.

    within: the linear gap under which the nearest are fitted on the nonlinear model.
    """
    effect = state.effects[index]
    if gross(effect):
        return _gross_gaps(search, state, index)
    if search.starts_far(effect):
        return _gaps_afar(search, state, index, within)
    less = reduced(search, state, index)
    problem = state.fit.problem
    target = replace(problem, recorded=state.fit.voltage())
    tangents = Tangents(whitened_anew(less.fit, problem), [linearised(search, less)])
    change = problem.whitening(target.recorded - tangents.voltage)
    signature = tangents.away(change.ravel())
    snr = float(np.sqrt(signature @ signature))
    best: dict[str, tuple[float, Candidate]] = {}
    rivals = _rivals(search.candidates, effect)
    tangents.whiten(c for c in rivals if not discrete(c))
    for candidate in rivals:
        gap = _linear_gap(tangents, signature, candidate)
        if gap is not None and gap < best.get(candidate.name, (np.inf, None))[0]:
            best[candidate.name] = gap, candidate
    ranked = sorted(best.items(), key=lambda pair: pair[1][0])
    nearest: dict[str, float] = {}
    for rank, (name, (gap, candidate)) in enumerate(ranked):
        strong = snr > 20.0 and gap > 0.2 * snr and rank > 2
        worth = rank < MOST_FITTED and gap < within and not strong
        worth = worth or (not DISTINCT.admits(gap) and is_two_sided(name))
        fitted = None
        if worth and candidate.size and not search.spent:
            fitted = _fitted(target, tangents, less.effects, candidate)
        if fitted is not None:
            gap = min(gap, float(np.sqrt(fitted.chi2)))
            _declare_rival(nearest, search, state, fitted, gap)
        nearest[name] = min(float(gap), nearest.get(name, np.inf))
    return _ranked(nearest, search, state, index, snr)


def _ranked(
    nearest: dict[str, float], search: Search, state: Explanation, index: int, snr: float
) -> list[Gap]:
    """Gaps of names, those of the effect's identities among them, the nearest first."""
    _declare(nearest, search, state, index, 0.0)
    nearest.pop(state.effects[index].name, None)
    found = [Gap(name, min(gap, snr), snr) for name, gap in nearest.items()]
    return sorted(found, key=lambda g: g.gap)


def _declare(
    nearest: dict[str, float], search: Search, state: Explanation, index: int, gap: float
) -> None:
    """Puts the other sides of an effect's identities among the nearest names; gap: the effect's own
    to what was found, beyond which they may be."""
    for identity, side in other_sides(search, state, index):
        for name in identity.names:
            nearest[name] = min(max(gap, side.gap), nearest.get(name, np.inf))


def _declare_rival(
    nearest: dict[str, float], search: Search, state: Explanation, fitted: Fit, gap: float
) -> None:
    """The same of a rival, the last effect of its fit, that could be what was found."""
    if not DISTINCT.admits(gap) and is_two_sided(fitted.effects[-1].name):
        trial = replace(state, fit=fitted)
        _declare(nearest, search, trial, len(fitted.effects) - 1, gap)


def _gaps_afar(search: Search, state: Explanation, index: int, within: float) -> list[Gap]:
    """Of an effect that no tangent leads to: its signature is what the rest, fitted to it, leaves,
    and every rival within reach is fitted too; what a tangent promises is not kept so far away.
    Rivals that cannot be fitted, or would cost bodies when no more may be solved, have no gap."""
    less, problem = reduced(search, state, index), state.fit.problem
    target = replace(problem, recorded=state.fit.voltage())
    rough = replace(rough_problem(search, less), recorded=target.recorded)
    rest = _fitted_best(target, less)
    tangents = Tangents(rest)
    snr = float(np.sqrt(rest.chi2))
    best: dict[str, tuple[float, Candidate]] = {}
    for candidate in _rivals(search.candidates, state.effects[index]):
        if far_starts.is_far(candidate):
            if search.spent:
                continue
            misfit, _ = far_starts.start(rough, less.effects, rest.theta, [candidate])
            gap: float | None = float(np.sqrt(misfit))
        else:
            gap = _linear_gap(tangents, tangents.residual, candidate)
        if gap is not None and gap < best.get(candidate.name, (np.inf,))[0]:
            best[candidate.name] = gap, candidate
    costly = search.spent and any(far_starts.is_far(effect) for effect in less.effects)
    nearest: dict[str, float] = {}
    for name, (gap, candidate) in best.items():
        if gap >= within and not far_starts.is_far(candidate):
            nearest[name] = min(float(gap), nearest.get(name, np.inf))
            continue
        fitted = None
        if far_starts.is_far(candidate):
            _, start = far_starts.start(rough, less.effects, rest.theta, [candidate])
            fitted = _fitted_from(target, rough, [*less.effects, candidate], start)
        elif not costly:
            fitted = _fitted(target, tangents, less.effects, candidate)
        if fitted is not None:
            gap = float(np.sqrt(fitted.chi2))
            _declare_rival(nearest, search, state, fitted, gap)
            nearest[name] = min(gap, nearest.get(name, np.inf))
    return _ranked(nearest, search, state, index, snr)


def _fitted_best(target: Problem, less: Explanation) -> Fit:
    """The effects of a state fitted to a signature from where they are and, where the physics has
    such a skin, from the beliefs."""
    here = fit(target, less.effects, less.fit.theta, polish=True)
    try:
        anew = fit(target, less.effects, np.zeros_like(less.fit.theta), polish=True)
    except InputError:
        return here
    return min(here, anew, key=lambda fitted: fitted.chi2)


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
    """Other names at one site, or with the effect's own scope, or in its own channels: more freedom
    than the effect has would fit anything."""
    found = []
    for candidate in candidates:
        if candidate.name == effect.name or candidate.effect.tone:
            continue
        if candidate.kind == "channels":
            if effect.kind == "channels":
                same = candidate if effect.scope == "dense" else sparse(candidate, effect.own_sites)
                found.append(same)
        elif candidate.scope != "dense" or effect.scope == "dense":
            found.append(candidate)
    return found


def _linear_gap(tangents: Tangents, signature: np.ndarray, candidate: Candidate) -> float | None:
    if discrete(candidate):
        change = tangents.tried(candidate)
        if change is None:
            return None
        left = signature - change
        return float(np.sqrt(min(left @ left, signature @ signature)))
    columns = tangents.of(candidate)
    if not len(columns):
        return None
    gain, _ = explained(columns, signature)
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


def _gross_gaps(search: Search, state: Explanation, index: int) -> list[Gap]:
    """Of a gross fault: to the other gross faults in its place, and to nothing."""
    model, whitening = search.problem.model, state.fit.problem.whitening
    knobs = state.fit.theta[: len(model.calibrations)]
    chosen = state.fit.settings()
    there = state.fit.voltage()
    others = [s for i, s in enumerate(chosen) if i != index]

    def apart(settings: list) -> float:
        change = whitening(model.voltage(knobs, settings) - there)
        return float(np.sqrt((change**2).sum()))

    snr = apart(others)
    best: dict[str, float] = {}
    for candidate in search.candidates:
        if gross(candidate) and candidate.name != state.effects[index].name:
            gap = apart([*others, candidate.setting(np.zeros(candidate.size))])
            best[candidate.name] = min(gap, best.get(candidate.name, snr))
    return sorted((Gap(n, g, snr) for n, g in best.items()), key=lambda g: g.gap)


def strengths(search: Search, state: Explanation) -> dict[str, float]:
    """SNR of every name at a typical size where it shows best, what is fitted projected out; 0 of
    those that change nothing here."""
    tangents = linearised(search, state)
    tangents.whiten(c for c in search.candidates if of_tangents(c) and c.scope != "dense")
    found: dict[str, float] = {}
    for candidate in search.candidates:
        if candidate.effect.tone:
            snr = np.inf if search.problem.model.frame_s else 0.0
        elif candidate.kind == "channels":
            snr = np.inf if candidate.kind == candidate.effect.sites[0] else 0.0
        elif gross(candidate):
            snr = np.inf
        elif candidate.scope == "dense" or discrete(candidate):
            continue
        else:
            columns = tangents.each(candidate)
            snr = max((float(np.linalg.norm(c)) for c in columns if c is not None), default=0.0)
        found[candidate.name] = max(found.get(candidate.name, 0.0), snr)
    return found
