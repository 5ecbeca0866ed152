"""The members of the families that a recording has, fitted: a normal prior each, of learned sd.

While effects are sought the members are part of the covariance, linear about a fit. Then they are
coordinates of the fit itself, beside the calibrations: the simulation has them, predictions of
readings left out are made with them, and no discrepancy of theirs is in any covariance.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.families import family_name, members
from eitskin.diagnose.fitting.family_sizes import FamilySizes
from eitskin.diagnose.fitting.fit import Fit, FitLimits, Problem, fit, renewed_slopes
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.families import Family
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.search.explanation import Explanation, added_effect
from eitskin.diagnose.search.growth import (
    Outcome,
    at_start,
    cut_short,
    with_another_effect,
)
from eitskin.diagnose.search.refits import calibrated, explain, settled, with_effect
from eitskin.diagnose.search.screen import chance_p_value, sparse
from eitskin.diagnose.search.search import Cache, Search
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.errors import InputError

MEMBERS_SHARE = 0.25  # of a budget, that is left for what comes beside fitted members
JOINING_ROUNDS = 4  # in which families join others, at most
SILENT_ALONE = ("ground-leak",)  # at one site, where the source is tied to nothing
JOINING_SD = 0.1  # typical changes, that a family has which untouched frames do not show
SIZE_ROUNDS = 4  # in which members and sizes follow each other, at most
SAME_SIZE = 0.1  # of a size, by which another round may still change it
MOST_CULPRITS = 0.25  # of a family's members, that effects may be: more are the family


def family_sds(explanation: Explanation) -> dict[str, float]:
    """The sds of the families that an explanation has in its covariance, in typical changes."""
    return {
        name: sd
        for name, sd in explanation.error_sds.items()
        if sd > 0.0 and isinstance(COMPONENTS[name], Family)
    }


def with_members(outcome: Outcome) -> Outcome:
    """An outcome of a search whose families are fitted; itself where the explanation, linearised
    about its own fit (`settled`), has none.

    Beside fitted members less is unexplained, which may show families that were too small: they
    join, and all are fitted anew.
    """
    search, calibration, explanation = outcome
    if explanation.rig is None or not family_sds(explanation):
        return outcome
    search = _with_budget_for_members(search, explanation)
    in_noise, explanation = _members_joined(search, explanation)
    return in_noise, _baseline(calibration, in_noise), explanation


def grown_with_members(outcome: Outcome) -> Outcome:
    """`with_members`, and the effects that are warranted beside fitted families.

    What an effect explains is the families' no more, and without it their members may have gone
    anywhere: with each, sizes are learned again from the covariance on, and all members fitted
    anew.
    """
    search, calibration, explanation = outcome
    if explanation.rig is None or not family_sds(explanation):
        return outcome
    search = _with_budget_for_members(search, explanation)
    in_noise, grown = _members_joined(search, explanation)
    while (larger := with_another_effect(in_noise, grown)) is not None:
        begun_search, begun = _in_covariance(search, explanation, larger)
        if not family_sds(begun):
            return begun_search, calibration, begun
        in_noise, grown = _members_joined(begun_search, begun)
    return in_noise, _baseline(calibration, in_noise), grown


def _in_covariance(
    search: Search, begin: Explanation, larger: Explanation
) -> tuple[Search, Explanation]:
    """The effects of an explanation with fitted members where families are in the covariance, from
    the sizes of another explanation on; and the search about it."""
    assert begin.rig is not None
    problem = replace(search.problem, whitening=begin.rig.whitening(begin.error_sds, fitted=True))
    theta = _with_coordinates(larger.fit, problem.model)
    fitted = fit(problem, larger.effects, theta, polish=True)
    explained = explain(search, fitted, larger.p_values, begin.error_sds, begin.rig)
    return settled(search, explained)


def _with_budget_for_members(search: Search, explanation: Explanation) -> Search:
    """A search with MEMBERS_SHARE of a budget more than it has used."""
    if search.spent:
        cut_short(search, explanation)
    budget_used = max(search.budget_used, 1.0) * search.budget_share
    return replace(
        search, cache=Cache(null=search.cache.null), budget_share=budget_used + MEMBERS_SHARE
    )


def _members_joined(search: Search, explanation: Explanation) -> tuple[Search, Explanation]:
    """An explanation with the members of its families fitted, and the search beside them, which
    has no family in its covariance."""
    learned, rig, sds = explanation, explanation.rig, family_sds(explanation)
    assert rig is not None
    begin, returned = _without_common_culprits(learned.fit, search.problem.families)
    sds |= {n: max(sd, sds.get(n, 0.0)) for n, sd in returned.items() if n in rig.columns}
    derivatives = {name: rig.columns[name] for name in sds}
    for _ in range(JOINING_ROUNDS):
        rig_sds = {n: sd for n, sd in learned.error_sds.items() if n not in family_sds(learned)}
        problem = replace(search.problem, whitening=rig.whitening(rig_sds, fitted=True))
        fitted = _members_fitted(problem, begin, sds, derivatives)
        rig = linearised_rig_errors(fitted, search.problem.whitening, search.converter_step)
        explained = explain(search, fitted, learned.p_values, rig_sds, rig)
        learned = _with_culprits(search, explained)
        begin = learned.fit
        sds, joining = _sds(fitted.problem.model), family_sds(learned)
        if not sds or (learned is explained and not joining):
            break
        derivatives = _typical_derivatives(fitted.problem.model)
        derivatives |= {name: rig.columns[name] for name in joining}
        sds |= joining
    model = learned.fit.problem.model
    if model.families:
        search.report(f"a little wrong everywhere: {', '.join(_sds(model))}")
    fitted = replace(learned.fit, problem=replace(learned.fit.problem, families={}))
    in_noise = replace(search.problem, model=model, families={})
    rig = linearised_rig_errors(fitted, in_noise.whitening, search.converter_step)
    search = replace(search, problem=in_noise, rig=rig, cache=Cache(null=search.cache.null))
    return search, explain(search, fitted, learned.p_values, rig_sds, rig)


def _without_common_culprits(
    fitted: Fit, families: Mapping[str, tuple[Candidate, ...]]
) -> tuple[Fit, dict[str, float]]:
    """A fit without effects that are more than MOST_CULPRITS of the members of a family; and by
    family the rms of these effects' coordinates, in typical changes. Members that stand out of it
    are effects again once it is fitted."""
    sizes: dict[str, float] = {}
    removed: set[int] = set()
    for name, candidates in families.items():
        member, count = candidates[0], sum(len(c.sites or (0,)) for c in candidates)
        alike = [
            i
            for i, effect in enumerate(fitted.effects)
            if (effect.name, effect.kind) == (member.name, member.kind)
        ]
        named = sum(len(fitted.effects[i].sites or (0,)) for i in alike)
        if named > MOST_CULPRITS * count:
            values = [fitted.theta[fitted.coordinate_slice(i)] for i in alike]
            sizes[name] = float(np.sqrt((np.concatenate(values) ** 2).mean()))
            removed |= set(alike)
    places = [np.arange(len(fitted.theta))[fitted.coordinate_slice(i)] for i in removed]
    coordinates = np.concatenate(places) if places else np.zeros(0, int)
    effects = [effect for i, effect in enumerate(fitted.effects) if i not in removed]
    slopes = Jacobian(np.delete(fitted.jacobian, coordinates, axis=0))
    theta = np.delete(fitted.theta, coordinates)
    return replace(fitted, effects=effects, theta=theta, slopes=slopes), sizes


def _baseline(calibration: Explanation, in_noise: Search) -> Explanation:
    """The explanation without effects or members, in the simulator of a search with members."""
    return without_members(calibration, in_noise.problem.model, in_noise.rig)


def _with_culprits(search: Search, explanation: Explanation) -> Explanation:
    """An explanation with members that are likelier apart from their families as effects; itself
    where there is none."""
    model = explanation.fit.problem.model
    if not model.families:
        return explanation
    sites = {
        place.start + number: (family, site)
        for family, place in model.family_slices
        if family.sites is not None
        for number, site in enumerate(family.sites)
    }
    for coordinate, nats in FamilySizes.from_fit(explanation.fit).outlying(sites).items():
        family, site = sites[coordinate]
        trial = with_effect(search, explanation, sparse(family, (site,)))
        if isinstance(trial, Explanation):
            new = added_effect(explanation, trial)
            p_value = chance_p_value(2.0 * nats, 1, len(sites))
            explanation = trial.with_p_values({**trial.p_values, new.key: p_value})
            search.journal.step("add", new, explanation, p_value)
    return explanation


def _members_fitted(
    problem: Problem, begin: Fit, sds: dict[str, float], derivatives: dict[str, np.ndarray]
) -> Fit:
    """The fit of a problem with members of families, begun at another fit with its effects; sizes
    and members follow each other. sds: of the families, in typical changes; derivatives (K, N, M):
    by a typical change of each member."""
    fitted, plain = begin, problem.model.without_families()
    for number in range(SIZE_ROUNDS):
        families = {name: (problem.families[name], sd) for name, sd in sds.items()}
        model = _with_families(plain, families, derivatives)
        start = _with_coordinates(fitted, model)
        fitted = _polished(replace(problem, model=model), begin.effects, start)
        if number == 0:
            fitted = _relinearised(fitted)
            derivatives = _typical_derivatives(fitted.problem.model)
        sizes = FamilySizes.from_fit(fitted)
        greatest_sds, _ = sizes.greatest()
        is_settled = np.allclose(greatest_sds, sizes.sds, rtol=SAME_SIZE, atol=0.0)
        sds = {name: sd for name, sd in zip(sizes.names, greatest_sds, strict=True) if sd > 0.0}
        if not sds:
            start = _with_coordinates(fitted, plain)
            return _polished(replace(problem, model=plain), begin.effects, start)
        if is_settled and number > 0:
            break
    return _relinearised(fitted)


def _sds(model: RecordingSimulator) -> dict[str, float]:
    """The sds of the families of a simulator, in typical changes."""
    return {family_name(c): model.calibrations[s.start].sd for c, s in model.family_slices}


def among_calibrations(search: Search, untouched: Explanation) -> tuple[Search, StartingPoint]:
    """The search of a recording with families among its calibrations, and where it begins, from an
    explanation of the untouched frames; the same search where that has no family.

    Families that untouched frames do not show begin small: touches may show them. Sizes are learned
    again from all frames, beside the errors of the rig.
    """
    begin, sds = untouched, _sds(untouched.fit.problem.model)
    if not sds:
        return search, StartingPoint.from_explanation(untouched)
    problem = search.problem
    families = members(search.candidates)
    families = {n: f for n, f in families.items() if n in sds or n not in SILENT_ALONE}
    sds = {**dict.fromkeys(families, JOINING_SD), **sds}
    for _ in range(JOINING_ROUNDS):
        pairs = [
            (member, sds[n]) for n, family in families.items() if n in sds for member in family
        ]
        model = search.problem.model.without_families().with_families(pairs)
        theta = _with_coordinates(begin.fit, model)
        fitted = _polished(replace(problem, model=model), begin.effects, theta)
        search = replace(search, problem=_linear_in_members(fitted).problem)
        start = replace(StartingPoint.from_explanation(begin), theta=fitted.theta)
        in_noise, calibration = calibrated(search, fitted.theta[: len(model.calibrations)])
        begin = at_start(in_noise, calibration, start) or calibration
        sizes = FamilySizes.from_fit(begin.fit)
        greatest_sds, _ = sizes.greatest()
        if np.allclose(greatest_sds, sizes.sds, rtol=SAME_SIZE, atol=0.0):
            break
        sds = {name: sd for name, sd in zip(sizes.names, greatest_sds, strict=True) if sd > 0.0}
    search = without_members_as_candidates(search, search.problem.model.families)
    return search, StartingPoint.from_explanation(begin)


def without_members_as_candidates(search: Search, every_member: Iterable[Candidate]) -> Search:
    """A search whose candidates with a value at every site are none of the members of families."""
    family_members = list(every_member)
    keys = {member.key for member in family_members}
    candidates = [c for c in search.candidates if c.scope != "dense" or c.key not in keys]
    return replace(search, candidates=candidates, family_members=family_members)


def _relinearised(fitted: Fit) -> Fit:
    """A fit whose simulator has derivatives by the members as they are at its coordinates."""
    problem = fitted.problem
    afresh = replace(problem, model=problem.model.with_member_derivatives(None))
    return _linear_in_members(renewed_slopes(replace(fitted, problem=afresh)))


def _linear_in_members(fitted: Fit) -> Fit:
    """A fit whose simulator takes the derivatives by the members as the fit has them."""
    problem = fitted.problem
    stop = len(problem.model.calibrations)
    columns = fitted.jacobian[stop - problem.model.member_count : stop]
    derivatives = problem.whitening.unwhitened(columns)
    model = problem.model.with_member_derivatives(derivatives)
    return replace(fitted, problem=replace(problem, model=model))


def _typical_derivatives(model: RecordingSimulator) -> dict[str, np.ndarray]:
    """(K, N, M) by family: derivatives by a typical change of each member of a simulator."""
    coordinates, derivatives = model.member_columns
    columns: dict[str, list[np.ndarray]] = {}
    for candidate, place in model.family_slices:
        sd = model.calibrations[place.start].sd
        family = derivatives[place.start - coordinates[0] : place.stop - coordinates[0]]
        columns.setdefault(family_name(candidate), []).append(family / sd)
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def _with_families(
    model: RecordingSimulator,
    families: Mapping[str, tuple[tuple[Candidate, ...], float]],
    derivatives: Mapping[str, np.ndarray],
) -> RecordingSimulator:
    """A simulator with families: by name the candidates, their sd, and what a typical change of
    each member does to the readings."""
    pairs = [(candidate, sd) for family, sd in families.values() for candidate in family]
    model = model.without_families().with_families(pairs)
    if not pairs:
        return model
    scaled = [sd * derivatives[name] for name, (_, sd) in families.items()]
    return model.with_member_derivatives(np.concatenate(scaled))


def _with_coordinates(fitted: Fit, model: RecordingSimulator) -> np.ndarray:
    """(P,): coordinates of a fit in a simulator with families, whose members are as they were in
    the fit, 0 where they were not."""
    old, count = fitted.problem.model, len(fitted.problem.model.calibrations)
    plain_count = count - old.member_count
    values = {
        (*candidate.key, i): u
        for candidate, coordinates in old.family_coordinates(fitted.theta[:count])
        for i, u in enumerate(coordinates)
    }
    keys = [(*candidate.key, i) for candidate in model.families for i in range(candidate.size)]
    sds = [item.sd for item in model.calibrations[plain_count:]]
    coordinates = [values.get(key, 0.0) / sd for key, sd in zip(keys, sds, strict=True)]
    return np.r_[fitted.theta[:plain_count], coordinates, fitted.theta[count:]]


def without_members(
    explanation: Explanation, model: RecordingSimulator, rig: RigErrors | None
) -> Explanation:
    """An explanation in a simulator with families, whose members are all 0 and do nothing; rig: the
    errors of the rig about a fit there."""
    fitted = explanation.fit
    nothing = np.zeros((model.member_count, *fitted.residual.shape))
    model = model.with_member_derivatives(nothing)
    problem = replace(fitted.problem, model=model)
    count, size = len(fitted.problem.model.calibrations), len(model.calibrations)
    slopes = np.insert(fitted.jacobian, [count] * (size - count), 0.0, axis=0)
    theta = _with_coordinates(fitted, model)
    fitted = replace(fitted, problem=problem, theta=theta, slopes=Jacobian(slopes))
    return replace(explanation, fit=fitted, rig=rig)


def without_family(fitted: Fit, name: str) -> Fit:
    """A fit without one of its families, all the rest fitted anew, from its slopes on."""
    model = fitted.problem.model
    families: dict[str, tuple[tuple[Candidate, ...], float]] = {}
    for candidate, place in model.family_slices:
        family = family_name(candidate)
        members, _ = families.get(family, ((), 0.0))
        families[family] = (*members, candidate), model.calibrations[place.start].sd
    derivatives = _typical_derivatives(model)
    families.pop(name)
    reduced = _with_families(model, families, derivatives)
    start, problem = _with_coordinates(fitted, reduced), replace(fitted.problem, model=reduced)
    places = [np.r_[place] for c, place in model.family_slices if family_name(c) == name]
    jacobian = np.delete(fitted.jacobian, np.concatenate(places), axis=0)
    try:
        return fit(problem, fitted.effects, start, jacobian, polish=True, limits=FitLimits())
    except InputError:
        return _polished(problem, fitted.effects, start)


def _polished(problem: Problem, effects: list[Candidate], start: np.ndarray) -> Fit:
    """A fit at its optimum; where no skin is at its start, for members that made room for others
    are gone, it begins with all members at 0, or with the beliefs as they are."""
    count, member_count = len(problem.model.calibrations), problem.model.member_count
    members_at_0 = start.copy()
    members_at_0[count - member_count : count] = 0.0
    for begin in (start, members_at_0):
        try:
            return fit(problem, effects, begin, polish=True)
        except InputError:
            continue
    return fit(problem, effects, np.zeros_like(start), polish=True)
