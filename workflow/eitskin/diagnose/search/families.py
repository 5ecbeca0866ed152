"""The members of the families that a recording has, fitted: a normal prior each, of learned sd.

While effects are sought the members are part of the covariance, linear about a fit. Then they are
coordinates of the fit itself, beside the calibrations: the simulation has them, predictions of
readings left out are made with them, and no discrepancy of theirs is in any covariance.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.families import family_name
from eitskin.diagnose.fitting.family_sizes import FamilySizes
from eitskin.diagnose.fitting.fit import Fit, fit, renewed_slopes
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.families import Family
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.growth import Outcome, cut_short
from eitskin.diagnose.search.refits import explain
from eitskin.diagnose.search.search import Cache

MEMBERS_SHARE = 0.25  # of a budget, that is left for what comes beside fitted members
SIZE_ROUNDS = 4  # in which members and sizes follow each other, at most
SAME_SIZE = 0.1  # of a size, by which another round may still change it


def family_sds(explanation: Explanation) -> dict[str, float]:
    """The sds of the families that an explanation has in its covariance, in typical changes."""
    return {
        name: sd
        for name, sd in explanation.error_sds.items()
        if sd > 0.0 and isinstance(COMPONENTS[name], Family)
    }


def with_members(outcome: Outcome) -> Outcome:
    """An outcome of a search whose families are fitted; itself where the explanation, linearised
    about its own fit (`settled`), has none."""
    search, calibration, explanation = outcome
    sds = family_sds(explanation)
    if not sds or explanation.rig is None:
        return outcome
    rig_sds = {name: sd for name, sd in explanation.error_sds.items() if name not in sds}
    whitening = explanation.rig.whitening(rig_sds, fitted=True)
    problem = replace(explanation.fit.problem, whitening=whitening)
    fitted = replace(explanation.fit, problem=problem)
    derivatives = {name: explanation.rig.columns[name] for name in sds}
    for number in range(SIZE_ROUNDS):
        families = {name: (search.problem.families[name], sd) for name, sd in sds.items()}
        model = _with_families(search.problem.model, families, derivatives)
        start = _with_coordinates(fitted, model)
        fitted = fit(replace(problem, model=model), explanation.effects, start, polish=True)
        if number == 0:
            fitted = _relinearised(fitted)
            derivatives = _typical_derivatives(fitted.problem.model)
        sizes = FamilySizes.from_fit(fitted)
        greatest_sds, _ = sizes.greatest()
        is_settled = np.allclose(greatest_sds, sizes.sds, rtol=SAME_SIZE, atol=0.0)
        sds = {name: sd for name, sd in zip(sizes.names, greatest_sds, strict=True) if sd > 0.0}
        if (is_settled and number > 0) or not sds:
            break
    fitted = _relinearised(fitted)
    model = fitted.problem.model
    search.report(f"a little wrong everywhere: {', '.join(sizes.names)}")
    in_noise = replace(search.problem, model=model)
    rig = linearised_rig_errors(fitted, in_noise.whitening, search.converter_step)
    if search.spent:
        cut_short(search, explanation)
    budget_used = max(search.budget_used, 1.0) * search.budget_share
    search = replace(
        search,
        problem=in_noise,
        rig=rig,
        cache=Cache(null=search.cache.null),
        budget_share=budget_used + MEMBERS_SHARE,
    )
    baseline = replace(calibration, fit=_without_members(calibration.fit, model), rig=rig)
    return search, baseline, explain(search, fitted, explanation.p_values, rig_sds, rig)


def _relinearised(fitted: Fit) -> Fit:
    """A fit whose simulator has derivatives by the members as they are at its coordinates."""
    problem = fitted.problem
    afresh = replace(problem, model=problem.model.with_member_derivatives(None))
    fitted = renewed_slopes(replace(fitted, problem=afresh))
    stop = len(problem.model.calibrations)
    columns = fitted.jacobian[stop - problem.model.member_count : stop]
    derivatives = problem.whitening.unwhitened(columns)
    model = problem.model.with_member_derivatives(derivatives)
    return replace(fitted, problem=replace(problem, model=model))


def _typical_derivatives(model: RecordingSimulator) -> dict[str, np.ndarray]:
    """(K, N, M) by family: derivatives by a typical change of each member of a simulator."""
    members, derivatives = model.member_columns
    columns: dict[str, list[np.ndarray]] = {}
    for candidate, place in model.family_slices:
        sd = model.calibrations[place.start].sd
        family = derivatives[place.start - members[0] : place.stop - members[0]]
        columns.setdefault(family_name(candidate), []).append(family / sd)
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def _with_families(
    model: RecordingSimulator,
    families: Mapping[str, tuple[tuple[Candidate, ...], float]],
    derivatives: Mapping[str, np.ndarray],
) -> RecordingSimulator:
    """A simulator with families: by name the candidates, their sd, and what a typical change of
    each member does to the readings."""
    pairs = [(candidate, sd) for members, sd in families.values() for candidate in members]
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
    members = [values.get(key, 0.0) / sd for key, sd in zip(keys, sds, strict=True)]
    return np.r_[fitted.theta[:plain_count], members, fitted.theta[count:]]


def _without_members(fitted: Fit, model: RecordingSimulator) -> Fit:
    """A fit in a simulator with families, whose members are all 0 and do nothing."""
    nothing = np.zeros((model.member_count, *fitted.residual.shape))
    model = model.with_member_derivatives(nothing)
    problem = replace(fitted.problem, model=model)
    count, size = len(fitted.problem.model.calibrations), len(model.calibrations)
    slopes = np.insert(fitted.jacobian, [count] * (size - count), 0.0, axis=0)
    theta = _with_coordinates(fitted, model)
    return replace(fitted, problem=problem, theta=theta, slopes=Jacobian(slopes))


def without_family(fitted: Fit, name: str) -> Fit:
    """A fit without one of its families, all the rest fitted anew."""
    model = fitted.problem.model
    families: dict[str, tuple[tuple[Candidate, ...], float]] = {}
    for candidate, place in model.family_slices:
        family = family_name(candidate)
        members, _ = families.get(family, ((), 0.0))
        families[family] = (*members, candidate), model.calibrations[place.start].sd
    derivatives = _typical_derivatives(model)
    families.pop(name)
    reduced = _with_families(model, families, derivatives)
    start = _with_coordinates(fitted, reduced)
    return fit(replace(fitted.problem, model=reduced), fitted.effects, start, polish=True)
