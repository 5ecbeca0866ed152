"""Sets of effects fitted to a recording, with the sds of the rig's errors learned beside them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.candidates import Candidate, is_discrete
from eitskin.diagnose.fitting.fit import (
    JACOBIAN_RENEWALS,
    MAX_ITERATIONS,
    Fit,
    FitLimits,
    Problem,
    expected_decrease,
    fit,
    gauss_newton_step,
    renewed_slopes,
    rewhitened,
)
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.component_sds import SETTLED, learn_error_sds
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.noise.scoring import ScoringCache
from eitskin.diagnose.search import far_starts
from eitskin.diagnose.search.explanation import Explanation, marginal_likelihood, occam_factor
from eitskin.diagnose.search.gates import (
    ASTRAY,
    BUDGET,
    ENTRY,
    FORLORN,
    PHYSICS,
    SITES,
    STARTS,
)
from eitskin.diagnose.search.journal import Refusal
from eitskin.diagnose.search.prediction import is_gross
from eitskin.diagnose.search.search import Search
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.physics.solver import EffortExceeded

Part = TypeVar("Part")
Result = TypeVar("Result")

LEARNING_ROUNDS = 4  # in which a fit and the sds of the rig's errors follow each other, at most
DISCREPANCY = "static-discrepancy"  # the component of one value a channel
# Share of the readings that is left unexplained, as a far fit counts it: at most, so that it goes
# somewhere; at least, for bodies are solved coarsely there.
FAR_DISCREPANCY, COARSE_DISCREPANCY = 0.05, 3e-4
FAR_RENEWALS = 4  # of the Jacobian of a fit that begins far off
FAR_SHARE = 0.25  # of the budget, that such a fit may take: where noise is low a body takes more
PROCESSES = 4  # fits at once, of which none knows what the others solve


def explain(
    search: Search,
    fitted: Fit,
    p_values: Mapping[tuple, float] | None = None,
    error_sds: Mapping[str, float] | None = None,
    rig: RigErrors | None = None,
) -> Explanation:
    """The explanation of a recording by a fit: with the sds of the rig's errors learned, evidence
    and predictions.

    p_values: of its effects; error_sds: from which learning begins; rig: the errors about a fit
    like it. A discrepancy may have taken what an effect has to explain: the fit goes on without one
    as well, unless that is FORLORN, and the likelier of both counts.
    """
    explanation = _learned_explanation(
        search, fitted, p_values, error_sds, rig, search.cache.scoring
    )
    named = without_discrepancy(explanation, explanation.fit)
    if named is explanation.fit:
        return explanation
    named_sds = {k: s for k, s in explanation.error_sds.items() if not COMPONENTS[k].discrepancy}
    trial = gauss_newton_step(named)
    behind = explanation.log_likelihood - marginal_likelihood(trial, named_sds, explanation.rig)
    behind -= 0.5 * expected_decrease(trial)
    if trial is not named and not FORLORN.admits(behind) and not is_gross(search, explanation):
        return explanation
    plain = _learned_explanation(search, trial, p_values, named_sds, explanation.rig)
    return explanation if plain.log_evidence <= explanation.log_evidence else plain


def _learned_explanation(
    search: Search,
    fitted: Fit,
    p_values: Mapping[tuple, float] | None,
    error_sds: Mapping[str, float] | None,
    rig: RigErrors | None,
    start_scoring: ScoringCache | None = None,
) -> Explanation:
    """The explanation by a fit, which follows the sds of the rig's errors and these it."""
    sds, rig = dict(error_sds or {}), rig or search.rig
    if rig is not None:
        end_scoring = ScoringCache()
        for number in range(LEARNING_ROUNDS):
            scorings = (start_scoring or end_scoring) if number == 0 else end_scoring, end_scoring
            fitted, sds, rig, gain = _learning_round(search, fitted, sds, rig, *scorings)
            if gain < SETTLED:
                break
    likelihood = marginal_likelihood(fitted, sds, rig)
    evidence = likelihood + occam_factor(fitted)
    return Explanation(fitted, search.folds, likelihood, evidence, dict(p_values or {}), sds, rig)


def _learning_round(
    search: Search,
    fitted: Fit,
    error_sds: dict[str, float],
    rig: RigErrors,
    start_scoring: ScoringCache,
    end_scoring: ScoringCache,
) -> tuple[Fit, dict[str, float], RigErrors, float]:
    """A fit with the sds of the rig's errors learned from it, and by how many nats it moved on for
    them.

    Where touches are far from where they are reported to be, the readings are taken to follow in
    proportion from where they seem to be (Lindstrom, Bates, Biometrics 46, 1990).
    """
    error_sds, _ = learn_error_sds(rig, fitted.misfit, error_sds, start_scoring, end_scoring)
    model = touches.relocated_touches(search.problem, fitted, rig, error_sds)
    problem = fitted.problem
    followed = model is not problem.model
    if followed:
        displaced = replace(fitted, problem=replace(search.problem, model=model))
        rig = linearised_rig_errors(displaced, search.problem.whitening, search.converter_step)
        strays = touches.displacements(model, search.problem.model)
        recorded = search.problem.readings + rig.response(strays)
        problem = replace(search.problem, model=model, readings=recorded)
    problem = replace(problem, whitening=rig.whitening(error_sds, fitted=True))
    start = rewhitened(fitted, problem)
    end = gauss_newton_step(start, 2.0 * SETTLED)
    gain = np.inf if followed else 0.5 * (start.cost - end.cost)
    return end, error_sds, rig, gain


def in_processes(
    search: Search,
    explanation: Explanation,
    function: Callable[[Part], Result],
    parts: Sequence[Part],
) -> list[Result]:
    """A function of every part, which fits something about an explanation, in processes of their
    own. Each may solve all that may still be solved, PROCESSES at once; then what they solved
    counts."""
    if len(parts) < 2:
        return [function(part) for part in parts]
    if explanation.rig is not None and not search.tries_bodies:
        search.cache.scoring.prepare(explanation.rig, explanation.error_sds)
    shared = [*explanation.effects, explanation.rig, *_shared_objects(explanation.fit.problem)]
    results: list[Result] = []
    for start in range(0, len(parts), PROCESSES):
        results += forked(search, function, parts[start : start + PROCESSES], shared)
    return results


def forked(
    search: Search,
    function: Callable[[Part], Result],
    parts: Sequence[Part],
    shared: Sequence[object] = (),
) -> list[Result]:
    """A function of every part, each in a process of its own: what it changes in this search but
    its result is lost; the result may refer to what is shared. In this process, one after the
    other, where bodies are tried: two at once take too much memory."""
    if search.tries_bodies:
        return [function(part) for part in parts]
    common = [*EFFECTS.values(), search.folds, search.rig, *_shared_objects(search.problem)]
    return search.problem.model.solved_skins.forked(function, parts, [*common, *shared])


def _shared_objects(problem: Problem) -> list[object]:
    whitening = problem.whitening
    arrays = whitening.mask, whitening.sd, whitening.offset_ratio, whitening.frame_number
    return [problem, *vars(problem).values(), *vars(problem.model).values(), *arrays]


def calibrated(search: Search, theta: np.ndarray | None = None) -> tuple[Search, Explanation]:
    """The owner's beliefs with their calibrations fitted, no effect; and the search with the rig's
    errors about that fit. theta (P,): coordinates of the calibrations where the fit begins, by
    default the beliefs."""
    start = np.zeros(len(search.problem.model.calibrations)) if theta is None else theta
    best = fit(search.problem, [], start, polish=True)
    if search.learns_rig and search.rig is None:
        rig = linearised_rig_errors(best, search.problem.whitening, search.converter_step)
        search = replace(search, rig=rig)
    from_tangents = explain(search, best)
    far = from_far(search, from_tangents, [[]]) if search.learns_rig and search.untouched else None
    if not isinstance(far, Explanation) or far.log_evidence <= from_tangents.log_evidence:
        return search, from_tangents
    return search, far


def as_reported(search: Search, fitted: Fit) -> np.ndarray:
    """(N, M): the readings by a fit, with touches where they are reported to be."""
    return search.problem.model.voltage(*search.problem.split(fitted.theta, fitted.effects))


def without_discrepancy(explanation: Explanation, fitted: Fit) -> Fit:
    """A fit of an explanation without a discrepancy in its covariance."""
    sds = {n: s for n, s in explanation.error_sds.items() if not COMPONENTS[n].discrepancy}
    unchanged = sum(sds.values()) == sum(explanation.error_sds.values())
    if explanation.rig is None or unchanged:
        return fitted
    whitening = explanation.rig.whitening(sds, fitted=True)
    return rewhitened(fitted, replace(fitted.problem, whitening=whitening))


def named_fit(explanation: Explanation) -> Fit:
    """The fit of an explanation without a discrepancy in its covariance, at its optimum there."""
    named = without_discrepancy(explanation, explanation.fit)
    if named is explanation.fit:
        return named
    return fit(named.problem, named.effects, named.theta, named.jacobian, polish=True)


def settled(search: Search, explanation: Explanation) -> tuple[Search, Explanation]:
    """An explanation whose rig errors are linearised about its own fit, their sds learned once
    more; and the search with these errors."""
    if search.rig is None:
        return search, explanation
    rig = linearised_rig_errors(explanation.fit, search.problem.whitening, search.converter_step)
    search = replace(search, rig=rig)
    start = explanation.fit.theta
    fitted = fit(explanation.fit.problem, explanation.effects, start, polish=True)
    return search, explain(search, fitted, explanation.p_values, explanation.error_sds)


def linearised(search: Search, explanation: Explanation) -> Tangents:
    """Tangents about an explanation, cached until its set is fitted anew; their whitened columns
    until those of another set are asked for."""
    cache, key = search.cache, explanation.key
    if key not in cache.met or cache.met[key].fit is not explanation.fit:
        displaced = explanation.fit.problem.model is not search.problem.model
        fitted = renewed_slopes(explanation.fit) if displaced else explanation.fit
        cache.tangents[key] = Tangents(fitted, reversed(cache.tangents.values()))
        cache.met[key] = explanation
    tangents = cache.tangents[key]
    for unused in cache.tangents.values():
        if unused is not tangents:
            unused.clear_whitened()
    return tangents


def rough(search: Search, explanation: Explanation) -> Problem:
    """The problem with bodies solved coarsely, readings uncertain by what an explanation leaves
    unexplained, within COARSE_DISCREPANCY and FAR_DISCREPANCY: what no skin explains must not hide
    one that is nearly right, nor be fitted at any price."""
    if explanation.rig is None:
        return search.problem
    sd = explanation.error_sds.get(DISCREPANCY, 0.0)
    sd = float(np.clip(sd, COARSE_DISCREPANCY, FAR_DISCREPANCY))
    whitening = explanation.rig.whitening({DISCREPANCY: sd})
    return replace(
        search.problem, model=search.problem.model.with_coarse_bodies(), whitening=whitening
    )


def _attempted(
    search: Search, attempt: Callable[[], Explanation | Refusal], share: float = 1.0
) -> Explanation | Refusal:
    """What an attempt at fits within the budget, and a share of it, leads to; a refusal where it
    meets a skin that the physics does not have, or where that is used up."""
    solved_skins = search.problem.model.solved_skins
    limit = min(search.budget, solved_skins.effort + share * search.budget)
    try:
        with solved_skins.within(limit):
            return attempt()
    except (InputError, np.linalg.LinAlgError):
        return Refusal(PHYSICS, 0.0)
    except EffortExceeded:
        return Refusal(BUDGET, solved_skins.effort / limit)


def from_far(
    search: Search,
    explanation: Explanation,
    groups: Sequence[Sequence[Candidate]],
    sizes: Sequence[tuple[float, ...]] | None = None,
) -> Explanation | Refusal:
    """An explanation with one of several groups of candidates fitted from the beliefs, whatever it
    made of them: that whose coarse fit is nearest to the readings; sizes: the candidates'
    coordinates that are tried (`far_starts.start`)."""
    problem = rough(search, explanation)
    sds = {DISCREPANCY: explanation.error_sds.get(DISCREPANCY, 0.0)}

    def attempt() -> Explanation | Refusal:
        fitted = None
        for start, group in _starts(problem, explanation.fit, groups, sizes):
            limits = FitLimits(np.inf if fitted is None else fitted.cost, FAR_RENEWALS)
            trial = fit(problem, [*explanation.effects, *group], start, limits=limits)
            if fitted is None or trial.cost < fitted.cost:
                fitted = trial
        if fitted is None:
            return Refusal(PHYSICS, 0.0)
        if not search.problem.model.coarse:
            fine_problem = replace(problem, model=search.problem.model)
            fitted = fit(fine_problem, fitted.effects, fitted.theta)
        refined = explain(search, fitted, explanation.p_values, sds)
        fine = fit(refined.fit.problem, fitted.effects, refined.fit.theta, refined.fit.jacobian)
        return explain(search, fine, explanation.p_values, refined.error_sds, refined.rig)

    return _attempted(search, attempt, FAR_SHARE)


def _starts(
    problem: Problem,
    fitted: Fit,
    groups: Sequence[Sequence[Candidate]],
    sizes: Sequence[tuple[float, ...]] | None,
) -> list[tuple[np.ndarray, Sequence[Candidate]]]:
    """Coordinates where fits of groups beside a fit's effects begin, the nearest to the readings
    first: of each value of the first key of their starts one, as many as STARTS admits."""
    best: dict[tuple, tuple[float, np.ndarray, Sequence[Candidate]]] = {}
    for group in groups:
        chi2, start = far_starts.start(problem, fitted.effects, fitted.theta, group, sizes)
        key = tuple(next(iter(candidate.start.items()), ()) for candidate in group)
        if chi2 < best.get(key, (np.inf,))[0]:
            best[key] = chi2, start, group
    nearest = sorted(best.values(), key=lambda item: item[0])
    return [(start, group) for _, start, group in nearest[: int(STARTS.threshold)]]


def with_effect(
    search: Search,
    explanation: Explanation,
    candidate: Candidate,
    enough: float = np.inf,
    absorbed: bool = False,
) -> Explanation | Refusal:
    """An explanation with a candidate fitted beside its effects, or joined to a sparse effect of
    the same name; enough: the cost from which on the fit is worth its end (`fit`).

    absorbed: whether errors of the rig may have taken the effect to themselves: it is fitted before
    them as well, and the likelier end counts.
    """
    effects, theta = list(explanation.effects), explanation.fit.theta
    for index, effect in enumerate(effects):
        if effect.name != candidate.name or effect.kind != candidate.kind:
            continue
        if _joinable(effect, candidate):
            union = _joined(effect, candidate)
            if union is None:
                return Refusal(ENTRY, 0.0)
            if not search.journal.would_pass(SITES, len(union.site_indices), union.name):
                return Refusal(SITES, len(union.site_indices))
            place = explanation.fit.coordinate_slice(index)
            values = _joined_coordinates(effect, union, theta[place])
            start = np.r_[theta[: place.start], values, theta[place.stop :]]
            effects[index] = union
            return _fitted(search, effects, start, None, explanation, enough, absorbed)
        if not effect.effect.several or _is_same_entry(effect, candidate):
            return Refusal(ENTRY, 0.0)
    if search.starts_far(candidate):
        alike = (c for c in search.candidates if c.name == candidate.name)
        return from_far(search, explanation, [[c] for c in alike if search.starts_far(c)])
    start = np.r_[theta, np.zeros(candidate.size)]
    columns = linearised(search, explanation).jacobian(candidate)
    jacobian = np.concatenate([explanation.fit.jacobian, columns])
    return _fitted(search, [*effects, candidate], start, jacobian, explanation, enough, absorbed)


def _joinable(effect: Candidate, candidate: Candidate) -> bool:
    """Whether a candidate is an effect of the set at further sites."""
    return (
        {effect.scope, candidate.scope} == {"sparse"}
        and effect.start == candidate.start
        and bool(candidate.effect.parameters)
        and not candidate.effect.site_number
    )


def _joined(effect: Candidate, candidate: Candidate) -> Candidate | None:
    """The effect at the sites of both; None where these are its own."""
    sites = tuple(sorted({*effect.site_indices, *candidate.site_indices}))
    if len(sites) == len(effect.site_indices):
        return None
    return replace(effect, sites=sites, scope="sparse", looks=effect.looks * candidate.looks)


def _joined_coordinates(effect: Candidate, union: Candidate, theta: np.ndarray) -> np.ndarray:
    """Coordinates of an effect at more sites: theta (k,) where it was, 0 at the new sites."""
    values = np.zeros(union.size)
    for i, (parameter, site_index) in enumerate(union.names):
        if site_index is None:
            values[i] = theta[effect.names.index((parameter, None))]
        elif (site := union.site_indices[site_index]) in effect.site_indices:
            name = (parameter, effect.site_indices.index(site))
            values[i] = theta[effect.names.index(name)]
    return values


def _is_same_entry(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates of a name would be one entry: their starts agree in all keys that both
    have."""
    return all(b.start[key] == value for key, value in a.start.items() if key in b.start)


def _fitted(
    search: Search,
    effects: list[Candidate],
    start: np.ndarray,
    jacobian: np.ndarray | None,
    explanation: Explanation,
    enough: float,
    absorbed: bool,
) -> Explanation | Refusal:
    """Effects fitted from a start in the covariance of an explanation; where they may be absorbed,
    the likelier of that and `_effects_first`."""
    if absorbed:
        ends = [
            _fitted(search, effects, start, jacobian, explanation, enough, False),
            _effects_first(search, effects, start, explanation),
        ]
        fitted_ends = [end for end in ends if isinstance(end, Explanation)]
        return max(fitted_ends, key=lambda end: end.log_evidence, default=ends[0])

    def attempt() -> Explanation | Refusal:
        problem = explanation.fit.problem
        fitted = fit(problem, effects, start, jacobian, limits=FitLimits(enough))
        far_off = jacobian is not None and is_gross(search, explanation)
        # Calibrations that took what an effect is may lie far off along a narrow valley.
        if is_discrete(effects[-1]) or far_off or not fitted.converged:
            count = len(search.problem.model.calibrations)
            afresh = np.r_[np.zeros(count), start[count:]]
            from_beliefs = fit(problem, effects, afresh, limits=FitLimits(enough))
            fitted = min(fitted, from_beliefs, key=lambda f: f.chi2)
        behind = 0.5 * (fitted.cost - explanation.fit.cost)
        if not search.journal.would_pass(ASTRAY, behind, effects[-1].name):
            return Refusal(ASTRAY, behind)
        p_values, sds = explanation.p_values, explanation.error_sds
        return explain(search, fitted, p_values, sds, explanation.rig)

    return _attempted(search, attempt)


def _effects_first(
    search: Search,
    effects: list[Candidate],
    start: np.ndarray,
    explanation: Explanation,
) -> Explanation | Refusal:
    """Effects fitted from a start in noise alone, with touches where they are reported to be; the
    sds of the rig's errors are learned from 0 about that fit."""

    def attempt() -> Explanation | Refusal:
        fitted = fit(search.problem, effects, start)
        rig = linearised_rig_errors(fitted, search.problem.whitening, search.converter_step)
        return explain(search, fitted, explanation.p_values, {}, rig)

    return _attempted(search, attempt)


def without(search: Search, explanation: Explanation, index: int) -> Explanation:
    """An explanation less effect `index`, the rest fitted anew; from the beliefs where no skin has
    the rest alone."""
    whole_fit = explanation.fit
    place = whole_fit.coordinate_slice(index)
    effects = [c for i, c in enumerate(whole_fit.effects) if i != index]
    theta = np.delete(whole_fit.theta, np.arange(place.start, place.stop))
    jacobian = np.delete(whole_fit.jacobian, np.arange(place.start, place.stop), axis=0)
    try:
        fitted = fit(whole_fit.problem, effects, theta, jacobian)
    except InputError:
        fitted = fit(whole_fit.problem, effects, np.zeros_like(theta))
    return explain(search, fitted, explanation.p_values, explanation.error_sds, explanation.rig)


def each_without(
    search: Search, explanation: Explanation, count: int
) -> list[tuple[int, Explanation]]:
    """`without` each of the first `count` effects, with its number."""
    fits = in_processes(
        search, explanation, lambda index: without(search, explanation, index), range(count)
    )
    return list(enumerate(fits))


def polished(search: Search, fitted: Fit) -> Fit:
    """A fit at its optimum, with a fresh Jacobian; near it, where the budget is used up."""
    limits = FitLimits(renewals=JACOBIAN_RENEWALS if search.spent else MAX_ITERATIONS)
    start = fitted.theta, fitted.jacobian
    return fit(fitted.problem, fitted.effects, *start, polish=True, limits=limits)


def reduced(search: Search, explanation: Explanation, index: int) -> Explanation:
    """An explanation less effect `index`, polished unless the budget is used up; cached. A set that
    was met is that one."""
    cache = search.cache
    key = tuple(c.key for i, c in enumerate(explanation.effects) if i != index)
    if key in cache.met:
        return replace(cache.met[key], p_values=dict(explanation.p_values))
    whole_fit, reduced_set = cache.reduced.get(key, (None, None))
    if reduced_set is None or whole_fit is not explanation.fit:
        reduced_set = without(search, explanation, index)
        if not search.spent:
            fitted = polished(search, reduced_set.fit)
            reduced_set = explain(
                search, fitted, reduced_set.p_values, reduced_set.error_sds, reduced_set.rig
            )
        cache.reduced[key] = explanation.fit, reduced_set
    return replace(reduced_set, p_values=dict(explanation.p_values))
