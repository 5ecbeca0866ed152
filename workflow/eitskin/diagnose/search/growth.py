"""The smallest set of effects that explains a recording: forward, backward, and rivals in place.

Score tests screen every candidate; the best of every name are fitted on the nonlinear model,
jointly with all that is there. An effect enters if chance alone gives so good a score, over all
that is looked at, less than once in a thousand recordings, and if held-out frames are better
predicted by more than two standard errors. After every step each effect must stand against its
own absence; at the end against every other name in its place.
"""

from dataclasses import replace

import numpy as np

from eitskin.diagnose.fitting.candidates import (
    Candidate,
    is_by_channel,
    is_wiring_fault,
    replaces_instrument,
    without_site,
)
from eitskin.diagnose.fitting.family_sizes import standing_out
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.component_sds import SETTLED
from eitskin.diagnose.search import channels, last_resorts
from eitskin.diagnose.search.explanation import Explanation, added_effect
from eitskin.diagnose.search.gates import (
    BUDGET,
    CATCH_UP,
    CHANCE,
    CULPRIT,
    EFFECTS_OF_A_SET,
    EVIDENCE,
    FREEDOM,
    GROSS_MISFIT,
    GROSS_SHARE,
    PLACE,
    PREDICTION,
    UNLIKE,
    Gate,
)
from eitskin.diagnose.search.journal import CUT_SHORT, START, UNLIKE_STEP, Refusal
from eitskin.diagnose.search.prediction import is_gross, is_unlike, likeness, misfit, sure_gain
from eitskin.diagnose.search.proposals import (
    TINY,
    best_p_value,
    draw_null,
    global_p,
    ratio_p_value,
    scores,
    trials,
)
from eitskin.diagnose.search.refits import (
    LEARNING_ROUNDS,
    calibrated,
    each_without,
    explain,
    in_processes,
    linearised,
    named_fit,
    polished,
    reduced,
    settled,
    with_effect,
    without,
    without_discrepancy,
)
from eitskin.diagnose.search.screen import Score, chance_p_value, subset_choices
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.errors import InputError

FEW_SITES = 2  # of a sparse effect; with more, single sites are tried in its place

Outcome = tuple[Search, Explanation, Explanation]


def run(
    search: Search,
    start: StartingPoint | None = None,
    calibration: Explanation | None = None,
) -> Outcome:
    """The search as it ended, the explanation without an effect, and the best one; start: effects
    that fewer frames showed; calibration: the calibrated explanation, where it is known."""
    if calibration is None:
        search, calibration = calibrated(search, calibration_start(search, start))
    if start is None or not start.effects:
        return grown(search, calibration)
    return grown(search, calibration, at_start(search, calibration, start))


def calibration_start(search: Search, start: StartingPoint | None) -> np.ndarray | None:
    """Where the calibrations are fitted from: with families among them from a starting point, all
    else from the beliefs."""
    model = search.problem.model
    if start is None or not model.families:
        return None
    return start.theta[: len(model.calibrations)]


def grown(search: Search, calibration: Explanation, begin: Explanation | None = None) -> Outcome:
    """Grow a set of effects from the calibrated explanation, or from `begin`, which has some; the
    search as it ended, the calibrated explanation, and the best one."""
    search.journal.step("calibrate", None, calibration)
    if begin is not None:
        for effect in begin.effects:
            p_value = begin.p_value(effect) if begin.p_values else None
            search.journal.step(START, effect, begin, p_value)
        if not replaces_instrument(begin.effects):
            if _tries_last_resorts(search, begin):
                in_blur, another = last_resorts.another_instrument(search, calibration)
                if another is not None:
                    return in_blur, calibration, another
            return (
                search,
                calibration,
                _grown_and_stood(search, _drop(search, _confirmed(search, begin))),
            )
        blurred, begin = last_resorts.blurred(search, begin)
        confirmed = _drop(blurred, _confirmed(blurred, begin))
        if replaces_instrument(confirmed.effects):
            return blurred, calibration, confirmed
        search = blurred.restored()
        search.journal.step("not kept", None, calibration)
    explanation = calibration
    while (plain := _with_gross_fault(search, explanation)) is not None:
        search, explanation = plain
    unlike = is_unlike(search, explanation)
    if _tries_last_resorts(search, explanation):
        search, another = last_resorts.another_instrument(search, explanation)
        if another is not None:
            return search, calibration, another
    if unlike:
        search.journal.step(UNLIKE_STEP, None, calibration)
        return search, calibration, calibration
    with_body = _as_body(search, explanation) or explanation
    grown_set = _grown_and_stood(search, _with_objects(search, with_body))
    best = _without_freedom(search, explanation, grown_set)
    # What is unfinished has not lost to free channels.
    free = None if search.spent else _with_free_channels(search, explanation)
    if free is not None and free.log_evidence > best.log_evidence:
        search.journal.step("swap", free.effects[-1], free)
        best = _grown_and_stood(search, _drop(search, free))
    return search, calibration, best


def _tries_last_resorts(search: Search, explanation: Explanation) -> bool:
    """Whether another instrument is tried: where the readings are not those of a skin like this."""
    values = (
        (GROSS_MISFIT, misfit(search, explanation)),
        (UNLIKE, likeness(search, explanation)),
    )
    judge = search.journal.judge
    is_tried = is_unlike(search, explanation)
    for name in dict.fromkeys(c.name for c in search.last_resorts):
        is_tried |= all(judge(gate, value, name, explanation) for gate, value in values)
    return is_tried


def at_start(search: Search, calibration: Explanation, start: StartingPoint) -> Explanation | None:
    """The effects of a starting point fitted to all frames; None where that is no better than
    without them, or where no such skin exists."""
    try:
        fitted = fit(search.problem, start.effects, start.theta, polish=True)
        explanation = explain(search, fitted, start.p_values)
    except InputError:
        return None
    if explanation.log_evidence <= calibration.log_evidence or is_unlike(search, explanation):
        return None
    return explanation


def cut_short(search: Search, explanation: Explanation) -> None:
    """Record that the budget was used up, and that this is what there is."""
    search.report("as many skins are solved as may be: what was not tried by then stays untried")
    search.journal.step(CUT_SHORT, None, explanation)


def _grown_and_stood(search: Search, explanation: Explanation) -> Explanation:
    """What grows from an explanation, and stands against other names."""
    return _stand(search, _grow(search, explanation))


def _without_freedom(search: Search, start: Explanation, best: Explanation) -> Explanation:
    """The best explanation, or what grows from the start with less freedom, where that is better:
    many free values take what several plain effects explain together. First without the names that
    have a value at every site, then, where one has several sites still, without such subsets."""
    dense = {c.name for c in best.effects if c.scope == "dense"}
    if dense and not search.spent:
        names = ", ".join(sorted(dense))
        search.report(f"again without a free value at every site ({names})")
        plainer = [c for c in search.candidates if c.name not in dense or c.scope != "dense"]
        best = _rival(search, start, best, plainer)
    several = any(c.scope == "sparse" and len(c.site_indices) > FEW_SITES for c in best.effects)
    if several and not search.spent:
        search.report("again with single sites and pairs alone")
        sparse = [c for c in search.candidates if c.scope != "dense"]
        best = _rival(search, start, best, sparse)
    return best


def _as_body(search: Search, explanation: Explanation) -> Explanation | None:
    """An explanation as a body, where nobody touches and that is likelier; None elsewhere. It comes
    before all else: objects hide that a skin is a body, and other names take what it does."""
    bodies = [c for c in search.bodies if search.starts_far(c)]
    if not bodies or search.spent:
        return None
    search.journal.begin_round()
    trial = with_effect(search, explanation, bodies[0])
    if isinstance(trial, Refusal):
        search.journal.judge(trial.gate, trial.value, bodies[0], explanation)
        return None
    draw_null(search, linearised(search, explanation))
    new = added_effect(explanation, trial)
    search.cache.lacks[new.name] = explanation.log_evidence - trial.log_evidence
    p_value = ratio_p_value(search, Score(new, 0.0, new.size, -np.inf), explanation, trial)
    raised = trial.log_evidence - explanation.log_evidence
    judge = search.journal.judge
    if not (judge(EVIDENCE, raised, new, explanation) and judge(CHANCE, p_value, new, explanation)):
        return None
    trial = trial.with_p_values({**explanation.p_values, new.key: p_value})
    search.journal.step("add", new, trial, p_value)
    return trial


def _with_objects(search: Search, explanation: Explanation) -> Explanation:
    """An explanation with the objects in a skin that is a little wrong everywhere, where nobody
    touches, before any other name: families, and effects at many sites, take what objects do; an
    object takes nothing of theirs. Objects hide one another, so that two are tried at once where
    one more is not warranted."""
    objects = [c for c in search.candidates if c.effect.disc]
    if not (objects and search.problem.families):
        return explanation
    draw_null(search, linearised(search, explanation))
    branch = replace(
        search, candidates=objects, cache=search.cache.branch(), has_body=search.tries_bodies
    )
    grown_set = _grow(branch, explanation)
    while (with_pair := _with_two_more(branch, grown_set)) is not None:
        grown_set = with_pair
    search.cache.adopt(branch.cache)
    search.cache.trials.clear()  # of objects alone
    return grown_set


def _with_two_more(search: Search, explanation: Explanation) -> Explanation | None:
    """An explanation with two more effects, together likelier than none and each warranted beside
    the other, and what grows from them; None where there are none."""
    if search.spent or not EFFECTS_OF_A_SET.admits(_effect_count(search, explanation) + 1):
        return None
    ranked = trials(search, explanation, scores(search, explanation))
    pair = _warranted(search, ranked[0]) if ranked else None
    if pair is None:
        return None
    first, second = added_effect(explanation, ranked[0]), added_effect(ranked[0], pair)
    index = next((i for i, effect in enumerate(pair.effects) if effect.key == first.key), None)
    raised = pair.log_evidence - explanation.log_evidence
    if index is None or not search.journal.judge(EVIDENCE, raised, first, explanation):
        return None
    reduced_set = without(search, pair, index)
    p_value = _ratio_p(search, pair, first, reduced_set)
    if not _is_borne_out(search, pair, first, reduced_set, p_value):
        return None
    search.journal.step("add", first, ranked[0], p_value)
    search.journal.step("add", second, pair, pair.p_values[second.key])
    pair = pair.with_p_values({**pair.p_values, first.key: p_value})
    grown_set = _grow(search, _drop(search, pair))
    return grown_set if grown_set.log_evidence > explanation.log_evidence else None


def _rival(
    search: Search, start: Explanation, best: Explanation, candidates: list[Candidate]
) -> Explanation:
    """The best explanation, or what grows from the start out of other candidates, where that is
    better."""
    evidence = max(search.rival_evidence, best.log_evidence)
    branch = replace(
        search, candidates=candidates, rival_evidence=evidence, cache=search.cache.branch()
    )
    rival = _grown_and_stood(branch, start)
    if rival.log_evidence <= best.log_evidence:
        return best
    for effect in best.effects:
        if effect.key not in rival.key:
            value = best.log_evidence - rival.log_evidence
            search.journal.judge(FREEDOM, value, effect, rival)
    search.cache.adopt(branch.cache)
    return rival


def _with_free_channels(search: Search, explanation: Explanation) -> Explanation | None:
    """An explanation with a gain, or an offset, for every channel, which a few plain effects must
    beat; None where their score is no better than that of plainer candidates. None where nobody
    touches: they would fit whatever there is, and predict nothing."""
    if search.untouched:
        return None
    plain = max((s.log_evidence for s in scores(search, explanation)), default=0.0)
    base = linearised(search, explanation)
    # A discrepancy would take all of it to itself, until sds are learned again.
    tangents = Tangents(without_discrepancy(explanation, base.fit), [base])
    hopeful = []
    for candidate in search.candidates:
        if is_by_channel(candidate):
            free = channels.scores(tangents, candidate)[-1]
            p = global_p(search, free.p_value)
            if free.log_evidence > max(plain, EVIDENCE.threshold) and CHANCE.admits(p):
                hopeful.append((candidate, p))
    better = []
    fits = in_processes(
        search,
        explanation,
        lambda pair: with_effect(search, explanation, pair[0], absorbed=True),
        hopeful,
    )
    for (candidate, p), trial in zip(hopeful, fits, strict=True):
        if isinstance(trial, Explanation) and trial.log_evidence > explanation.log_evidence:
            better.append(trial.with_p_values({**trial.p_values, candidate.key: p}))
    return max(better, key=lambda trial: trial.log_evidence, default=None)


def with_another_effect(search: Search, explanation: Explanation) -> Explanation | None:
    """An explanation with one more effect beside its families, which are fitted by now; None where
    none is warranted, where what is left is no more than noise, and beside a body, of which a trial
    takes many times as long."""
    if any(search.starts_far(effect) for effect in explanation.effects):
        return None
    named = named_fit(explanation)
    size = max(named.problem.whitening.size - len(named.theta), 1)
    if named.chi2 < size or not EFFECTS_OF_A_SET.admits(_effect_count(search, explanation)):
        return None
    return _add(search, explanation)


def _grow(search: Search, explanation: Explanation) -> Explanation:
    """An explanation with effects added until none is warranted, until what comes goes again, or
    until as many as may still come, each as good as the last, could not reach `rival_evidence`."""
    met = set()
    while (
        EFFECTS_OF_A_SET.admits(_effect_count(search, explanation)) and explanation.key not in met
    ):
        met.add(explanation.key)
        better = _add(search, explanation)
        if better is None:
            break
        gain = better.log_evidence - explanation.log_evidence
        explanation = _drop(search, better)
        room = EFFECTS_OF_A_SET.threshold - _effect_count(search, explanation)
        lack = search.rival_evidence - explanation.log_evidence - room * gain
        if not CATCH_UP.admits(lack):
            break
    if not EFFECTS_OF_A_SET.admits(_effect_count(search, explanation)):
        _refuse_rest(search, EFFECTS_OF_A_SET, _effect_count(search, explanation), explanation)
    return explanation


def _effect_count(search: Search, explanation: Explanation) -> int:
    """The number of effects of a set without a body, which says what the skin is, not what is wrong
    with it."""
    return sum(not search.is_body(effect) for effect in explanation.effects)


def _refuse_rest(search: Search, gate: Gate, value: float, explanation: Explanation) -> None:
    """Record that every name that an explanation does not have stops at a gate."""
    search.journal.begin_round()
    names = {c.name for c in explanation.effects}
    for name in dict.fromkeys(c.name for c in search.candidates):
        if name not in names:
            search.journal.judge(gate, value, name, explanation)


def _with_gross_fault(
    search: Search, explanation: Explanation
) -> tuple[Search, Explanation] | None:
    """An explanation with one gross fault of the wiring, None where none is plain to see.

    Such a fault leads the calibrations astray, and what is linear about them: each is tried with
    the beliefs as they are, one common factor free.
    """
    if not is_gross(search, explanation):
        return None
    problem = search.problem
    recorded = problem.whitening(problem.readings)
    start = np.zeros(len(problem.model.calibrations))
    settings = explanation.fit.settings()
    keys = {c.key for c in explanation.effects}

    def unexplained(settings: list) -> float:
        simulated = problem.whitening(problem.model.voltage(start, settings))
        product = (simulated * recorded).sum()
        return float((recorded**2).sum() - product**2 / (simulated**2).sum())

    faults = [c for c in search.candidates if is_wiring_fault(c)]
    remainders = [
        (unexplained([*settings, c.setting(np.zeros(c.size))]), i)
        for i, c in enumerate(faults)
        if c.key not in keys
    ]
    remainder, best = min(remainders)
    share = remainder / max(unexplained(settings), TINY)
    if not search.journal.judge(GROSS_SHARE, share, faults[best], explanation):
        return None
    effects = [*explanation.effects, faults[best]]
    theta = np.r_[start, np.zeros(sum(c.size for c in effects))]
    trial = explain(search, fit(problem, effects, theta, polish=True))
    raised = trial.log_evidence - explanation.log_evidence
    if not search.journal.judge(EVIDENCE, raised, faults[best], explanation):
        return None
    draw_null(search, linearised(search, trial))
    gain = 2.0 * (trial.log_likelihood - explanation.log_likelihood)
    p = global_p(search, chance_p_value(gain, 1 + faults[best].size))
    search, trial = settled(search, trial)
    trial = trial.with_p_values({**explanation.p_values, faults[best].key: p})
    search.journal.step("add", faults[best], trial, p)
    return search, trial


def _add(search: Search, explanation: Explanation) -> Explanation | None:
    """An explanation with one more effect, None where none is warranted; the step is recorded."""
    trial = _warranted(search, explanation)
    if trial is not None:
        new = added_effect(explanation, trial)
        search.journal.step("add", new, trial, trial.p_values[new.key])
    return trial


def _warranted(search: Search, explanation: Explanation) -> Explanation | None:
    """The best trial with one more effect that is warranted, None where none is."""
    ranked = scores(search, explanation)
    if not ranked:
        return None
    p_value = best_p_value(search, explanation)
    search.report(
        f"{len(explanation.effects)} effects, chi2/dof {explanation.chi2_per_dof:.3f}: best score "
        f"{ranked[0].candidate.name}, of which p = {p_value:.2g}"
    )
    if search.spent:
        _refuse_rest(search, BUDGET, search.budget_used, explanation)
        return None
    for trial in trials(search, explanation, ranked):
        new = added_effect(explanation, trial)
        raised = trial.log_evidence - explanation.log_evidence
        if not search.journal.judge(EVIDENCE, raised, new, explanation):
            continue
        p = trial.p_values[new.key]
        if not search.journal.judge(CHANCE, p, new, explanation):
            continue
        if _predicts(search, trial, explanation, new) and _is_needed(search, trial, new):
            return trial.with_p_values({**explanation.p_values, new.key: p})
    return None


def _predicts(
    search: Search, whole: Explanation, reduced_set: Explanation, effect: Candidate, place: str = ""
) -> bool:
    """Whether folds left out are surely better predicted with an effect than without, or it stands
    out of its family, which predicts them as well; place: as of a `Decision`."""
    culprit = standing_out(whole.fit, whole.effects.index(effect))
    if culprit is not None and CULPRIT.admits(culprit.p_value):
        return search.journal.judge(CULPRIT, culprit.p_value, effect, reduced_set, place)
    sure = sure_gain(search, whole, reduced_set)
    return search.journal.judge(PREDICTION, sure, effect, reduced_set, place)


def _is_needed(search: Search, trial: Explanation, new: Candidate) -> bool:
    """Whether a trial is better than without its new effect, where touches were followed: on its
    way to where they seem to be it may have found what the explanation before had not."""
    if trial.fit.problem.model is search.problem.model:
        return True
    reduced_set = without(search, trial, trial.effects.index(new))
    assert trial.score is not None
    p = ratio_p_value(search, trial.score, reduced_set, trial)
    raised = trial.log_evidence - reduced_set.log_evidence
    judge = search.journal.judge
    return judge(CHANCE, p, new, reduced_set) and judge(EVIDENCE, raised, new, reduced_set)


def _confirmed(search: Search, explanation: Explanation) -> Explanation:
    """An explanation from before, less the effects that all frames do not bear out, each with the
    p-value of its likelihood ratio on all of them."""
    draw_null(search, linearised(search, explanation))
    while True:
        for index, reduced_set in each_without(search, explanation, len(explanation.effects)):
            effect = explanation.effects[index]
            p = _ratio_p(search, explanation, effect, reduced_set)
            if not _is_borne_out(search, explanation, effect, reduced_set, p):
                search.journal.step("drop", effect, reduced_set, p)
                explanation = reduced_set
                break
            explanation = explanation.with_p_values({**explanation.p_values, effect.key: p})
        else:
            return explanation


def _ratio_p(
    search: Search, explanation: Explanation, effect: Candidate, reduced_set: Explanation
) -> float:
    """The global p-value of an effect of an explanation, by its likelihood ratio to the set
    without."""
    look = Score(effect, 0.0, max(effect.size, 1), 0.0, _choices(effect))
    return ratio_p_value(search, look, reduced_set, explanation)


def _is_borne_out(
    search: Search,
    explanation: Explanation,
    effect: Candidate,
    reduced_set: Explanation,
    p_value: float,
) -> bool:
    """Whether an effect of an explanation is warranted beside all its others."""
    judge = search.journal.judge
    raised = explanation.log_evidence - reduced_set.log_evidence
    return (
        judge(EVIDENCE, raised, effect, reduced_set)
        and judge(CHANCE, p_value, effect, reduced_set)
        and _predicts(search, explanation, reduced_set, effect)
    )


def _drop(search: Search, explanation: Explanation) -> Explanation:
    """An explanation less the effects that no longer earn their place, taken out one by one; the
    rest polished."""
    dropped = True
    while dropped and len(explanation.effects) > 1:
        dropped = False
        for index, reduced_set in each_without(search, explanation, len(explanation.effects) - 1):
            raised = explanation.log_evidence - reduced_set.log_evidence
            if not search.journal.judge(EVIDENCE, raised, explanation.effects[index], reduced_set):
                search.journal.step("drop", explanation.effects[index], reduced_set)
                explanation, dropped = reduced_set, True
                break
    trimmed = _trim(search, explanation)
    fitted = polished(search, trimmed.fit)
    return explain(search, fitted, trimmed.p_values, trimmed.error_sds, trimmed.rig)


def _trim(search: Search, explanation: Explanation) -> Explanation:
    """An explanation less the sites of sparse effects that do not earn their place, taken out one
    by one."""
    for index in range(len(explanation.effects)):
        effect = explanation.effects[index]
        if effect.effect.site_number:
            continue
        while effect.scope == "sparse" and effect.size == len(effect.site_indices) > 1:
            fitted_whole = explanation.fit
            place = fitted_whole.coordinate_slice(index)
            sd = np.sqrt(np.diag(fitted_whole.covariance)[place])
            weakest = int(np.argmin(np.abs(fitted_whole.theta[place]) / sd))
            fewer = without_site(effect, weakest)
            effects = [*explanation.effects[:index], fewer, *explanation.effects[index + 1 :]]
            theta = np.delete(fitted_whole.theta, place.start + weakest)
            jacobian = np.delete(fitted_whole.jacobian, place.start + weakest, axis=0)
            try:
                fitted = fit(fitted_whole.problem, effects, theta, jacobian)
            except InputError:
                break
            trial = explain(
                search, fitted, explanation.p_values, explanation.error_sds, explanation.rig
            )
            if EVIDENCE.admits(explanation.log_evidence - trial.log_evidence):
                break
            p = explanation.p_values.get(effect.key, 1.0)
            explanation = trial.with_p_values({**trial.p_values, fewer.key: p})
            effect = fewer
    return explanation


def _stand(search: Search, explanation: Explanation) -> Explanation:
    """Every effect against every other name in its place, until none gives way, or one takes the
    place back that it lost: the likeliest of the sets between which that goes on then."""
    if search.rival_evidence > explanation.log_evidence:
        return explanation
    stood = [explanation]
    for _ in range(int(EFFECTS_OF_A_SET.threshold)):
        for index, effect in enumerate(explanation.effects):
            if is_wiring_fault(effect) or search.spent:
                continue
            explanation, rival = _in_place(search, explanation, index)
            stood[-1] = explanation
            if rival is not None:
                explanation = _grow(search, _drop(search, rival))
                break
        else:
            return explanation
        stood.append(explanation)
        repeats = [i for i, s in enumerate(stood) if set(s.key) == set(explanation.key)]
        if len(repeats) > 1:
            best = max(reversed(stood[repeats[0] :]), key=lambda s: s.log_evidence)
            if best is not explanation:
                search.journal.step("take back", None, best)
            return best
    return explanation


def _in_place(
    search: Search, explanation: Explanation, index: int
) -> tuple[Explanation, Explanation | None]:
    """An explanation, fitted on before effect `index` gives way, as its rivals were fitted after
    it; and with another name in the effect's place, None where it stands."""
    effect, is_settled = explanation.effects[index], False
    reduced_set = reduced(search, explanation, index)
    ranked = scores(search, reduced_set)
    for rival in trials(search, reduced_set, ranked, effect, explanation.log_evidence):
        new = added_effect(reduced_set, rival)
        ahead = rival.log_evidence - _further_sites(effect, rival.effects[-1])
        if not is_settled and PLACE.admits(ahead - explanation.log_evidence):
            explanation, is_settled = _fitted_on(search, explanation), True
        ahead -= explanation.log_evidence
        if not search.journal.judge(PLACE, ahead, new, reduced_set, effect.name):
            continue
        if _predicts(search, rival, reduced_set, new, effect.name):
            p = rival.p_values[new.key]
            rival = rival.with_p_values({**explanation.p_values, new.key: p})
            search.journal.step("swap", new, rival, p)
            return explanation, rival
    return explanation, None


def _fitted_on(search: Search, explanation: Explanation) -> Explanation:
    """An explanation whose fit and sds of the rig's errors follow each other until its evidence
    rises by less than SETTLED."""
    for _ in range(LEARNING_ROUNDS):
        fitted = polished(search, explanation.fit)
        refitted = explain(
            search, fitted, explanation.p_values, explanation.error_sds, explanation.rig
        )
        gain = refitted.log_evidence - explanation.log_evidence
        explanation = refitted if gain > 0.0 else explanation
        if gain < SETTLED:
            break
    return explanation


def _choices(effect: Candidate) -> int:
    """Among how many looks an effect of the set was chosen (`Score.choices`)."""
    if effect.effect.tone:
        return effect.looks
    several = effect.scope == "sparse" and len(effect.site_indices) > 1
    return subset_choices(effect) if several else 1


def _further_sites(effect: Candidate, rival: Candidate) -> float:
    """Nats that a rival must have beyond PLACE: where it is the effect at further sites, what
    every site must earn."""
    sparse = effect.scope == rival.scope == "sparse" and rival.name == effect.name
    if sparse and set(rival.site_indices) > set(effect.site_indices):
        count = len(rival.site_indices) - len(effect.site_indices)
        return EVIDENCE.threshold * count - PLACE.threshold
    return 0.0
