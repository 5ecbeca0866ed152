"""What may come next beside a set of effects: every candidate scored, the best of every name
fitted."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eitskin import cores
from eitskin.diagnose.fitting.candidates import Candidate, is_by_channel, is_discrete, is_linearised
from eitskin.diagnose.fitting.fit import rewhitened
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.search import channels, tones
from eitskin.diagnose.search.explanation import Explanation, added_effect
from eitskin.diagnose.search.gates import (
    ABSORBED,
    AGAIN,
    BUDGET,
    COMPETING,
    HOPE,
    LINE,
    RACE,
    REACH,
    SIGNATURE,
    SURPRISE,
    Gate,
)
from eitskin.diagnose.search.journal import Refusal
from eitskin.diagnose.search.prediction import cost_for, is_gross
from eitskin.diagnose.search.refits import in_processes, linearised, with_effect
from eitskin.diagnose.search.screen import (
    Score,
    best_few,
    chance_p_value,
    null_distribution,
    score,
)
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.shortlist import shortlist
from eitskin.quantities import number

TINY = 1e-300  # chi squared below which there is nothing to explain


def scores(search: Search, explanation: Explanation) -> list[Score]:
    """Every candidate's score about an explanation, the best evidence first; cached."""
    fitted, ranked = search.cache.scores.get(explanation.key, (None, []))
    if fitted is not explanation.fit:
        ranked = _scores(search, explanation, linearised(search, explanation))
        search.cache.scores[explanation.key] = explanation.fit, ranked
    return ranked


def _scores(search: Search, explanation: Explanation, tangents: Tangents) -> list[Score]:
    keys = {c.key for c in explanation.effects}
    # So far off with effects in it, a set wants more than any few channels.
    hopeless = bool(explanation.effects) and not search.untouched and is_gross(search, explanation)
    open_candidates = [
        c for c in search.candidates if c.key not in keys and not search.starts_far(c)
    ]
    tangents.precompute(c for c in open_candidates if is_linearised(c))
    switches = [c for c in open_candidates if is_discrete(c) and not is_by_channel(c)]
    ranked: list[Score | None] = [*_switch_scores(search, explanation, tangents, switches)]
    for candidate in open_candidates:
        if is_by_channel(candidate):
            of_channel = channels.scores(tangents, candidate)
            ranked += [s for s in of_channel if s.candidate.scope == "sparse" or hopeless]
        elif candidate.effect.tone:
            ranked.append(_tone_score(search, explanation, tangents, candidate))
        elif not is_discrete(candidate):
            ranked.append(score(tangents, candidate))
            if candidate.scope == "dense":
                ranked.append(best_few(tangents, candidate))
    draw_null(search, tangents)
    scored = sorted((s for s in ranked if s is not None), key=lambda s: -s.log_evidence)
    for name in dict.fromkeys(c.name for c in open_candidates if not c.effect.tone):
        if name not in {s.candidate.name for s in scored}:
            search.journal.judge(SIGNATURE, False, name, explanation)
    return scored


def _tone_score(
    search: Search, explanation: Explanation, tangents: Tangents, candidate: Candidate
) -> Score | None:
    """The score of the strongest tone; None where there is none that stands out as a line."""
    tone = tones.score(tangents, candidate.effect, candidate.skin, candidate.scales)
    if tone is None:
        search.journal.judge(SIGNATURE, False, candidate.name, explanation)
        return None
    is_line = search.journal.judge(LINE, tone[1], tone[0].candidate, explanation)
    return tone[0] if is_line else None


def draw_null(search: Search, tangents: Tangents) -> None:
    """Draw the null distribution of the least p-value, once: score tests of single candidates are
    drawn; those of channels, of candidates without coordinates and tones, and of the best few of
    each dense one are counted."""
    if search.cache.null is not None:
        return
    linear, free = [], 0
    for candidate in search.candidates:
        if is_linearised(candidate):
            linear.append(candidate)
            free += candidate.scope == "dense"
        else:
            free += channels.looks(candidate) if is_by_channel(candidate) else 1
    search.report("drawing recordings in which nothing is missing")
    tangents.precompute(linear)
    search.cache.null = null_distribution(tangents, linear, free, search.seed)


def global_p(search: Search, local: float) -> float:
    """How often chance alone gives one look's p-value of `local` or less, over all that is looked
    at."""
    assert search.cache.null is not None
    return search.cache.null.p_value(local)


def best_p_value(search: Search, explanation: Explanation) -> float:
    """Global p-value of the best candidate beside an explanation, 1 where there is none."""
    return global_p(search, min((s.p_value for s in scores(search, explanation)), default=1.0))


def ratio_p_value(
    search: Search, score_test: Score, explanation: Explanation, trial: Explanation
) -> float:
    """Global p-value of what a trial has beyond an explanation: its likelihood ratio's (Wilks
    1938), the sds of the rig's errors learned for both."""
    gain = 2.0 * (trial.log_likelihood - explanation.log_likelihood)
    dof = max(score_test.dof, len(trial.fit.theta) - len(explanation.fit.theta))
    return global_p(search, replace(score_test, gain=max(gain, 0.0), dof=dof).p_value)


def _switch_scores(
    search: Search, explanation: Explanation, tangents: Tangents, candidates: list[Candidate]
) -> list[Score]:
    """Scores of candidates without tangents, by trying them; the calibrations follow to first
    order. One with coordinates counts at the size at which it fits best: a fit finds it. Left out
    are those that change nothing, or whose change is beyond REACH."""
    lengths, chi2 = search.cache.lengths, max(tangents.fit.chi2, TINY)

    def products(share: list[Candidate]) -> dict[tuple, tuple[float, float]]:
        changes = [(candidate.key, tangents.start_change(candidate)) for candidate in share]
        return {
            key: (float(c @ c), float(c @ tangents.residual)) for key, c in changes if c is not None
        }

    reached = [
        c
        for c in candidates
        if c.key not in lengths
        or search.journal.judge(REACH, lengths[c.key] / chi2, c, explanation)
    ]
    products_of: dict[tuple, tuple[float, float]] = {}
    shares = cores.shares([candidate] for candidate in reached)
    for part in search.problem.model.solved_skins.forked(products, shares):
        products_of |= part
    ranked = []
    for candidate in reached:
        if candidate.key not in products_of:
            continue
        length, product = products_of[candidate.key]
        lengths[candidate.key] = length
        if length == 0.0:
            continue
        gain = 2.0 * product - length
        if candidate.size and product > 0:
            gain = product**2 / length
        ranked.append(Score(candidate, gain, 1, 0.5 * gain - np.log(candidate.looks)))
    return ranked


def _hopeful_names(
    search: Search, explanation: Explanation, ranked: list[Score]
) -> dict[str, Score]:
    """The best score of every name that is worth its fits: of all where the best one is surprising
    enough, else of none."""
    values = (
        (SURPRISE, global_p(search, min(s.p_value for s in ranked))),
        (HOPE, ranked[0].log_evidence),
    )
    hopeful = {}
    for name, best in {s.candidate.name: s for s in reversed(ranked)}.items():
        detail = f"its own best score has a p-value of {number(global_p(search, best.p_value), 2)}"
        if search.journal.judge_any(values, best.candidate, explanation, detail):
            hopeful[name] = best
    return hopeful


def _with_absorbed(search: Search, explanation: Explanation, listed: list[Score]) -> list[Score]:
    """The best scores of names that would be significant if what one of the rig's errors, or all of
    them, have taken to themselves were open, the best first, and the other listed scores:
    until sds are learned again, what is alike in all presses is the rig's too."""
    best: dict[str, Score] = {}
    names_listed = {score_test.candidate.name for score_test in listed}
    names = [
        name
        for name, sd in explanation.error_sds.items()
        if sd > 0.0 and not COMPONENTS[name].discrepancy
    ]
    left_out: list[tuple[str, ...]] = [(name,) for name in names]
    if len(names) > 1:
        left_out.append(tuple(names))
    for components in left_out:
        for score_test in _without_components(search, explanation, components, names_listed):
            name = score_test.candidate.name
            if name not in best or score_test.log_evidence > best[name].log_evidence:
                best[name] = score_test
    absorbed = sorted(best.values(), key=lambda s: -s.log_evidence)
    keys = {s.candidate.key for s in absorbed}
    return [*absorbed, *(s for s in listed if s.candidate.key not in keys)]


def _without_components(
    search: Search, explanation: Explanation, components: tuple[str, ...], names_listed: set[str]
) -> list[Score]:
    """The best scores of names where some components are not in the covariance, as many as
    COMPETING admits; names that are listed anyway are not refused by it. Without them a candidate's
    information is no less, so that the score with them bounds that without."""
    assert explanation.rig is not None
    base = linearised(search, explanation)
    sds: Mapping[str, float] = {**explanation.error_sds, **dict.fromkeys(components, 0.0)}
    problem = replace(base.fit.problem, whitening=explanation.rig.whitening(sds, fitted=True))
    tangents = Tangents(rewhitened(base.fit, problem), [base])
    shape = tangents.voltage.shape
    residual = tangents.marginal(tangents.residual.reshape(shape))
    weights = problem.whitening.transposed(residual).ravel()
    bounds: dict[str, list[tuple[float, Candidate]]] = {}
    for score_test in scores(search, explanation):
        candidate = score_test.candidate
        if candidate.scope == "dense" or score_test.information is None:
            continue
        slope = tangents.raw_products(candidate, weights)
        gain = float(slope @ np.linalg.pinv(score_test.information) @ slope)
        p = chance_p_value(gain, score_test.dof)
        if ABSORBED.admits(global_p(search, p)):
            bounds.setdefault(candidate.name, []).append((p, candidate))

    def passes(gate: Gate, value: float, candidate: Candidate) -> bool:
        if candidate.name in names_listed:
            return gate.admits(value)
        return search.journal.judge(gate, value, candidate, explanation)

    best_scores = [_least(tangents, pairs) for pairs in bounds.values()]
    significant = [
        s
        for s in best_scores
        if s is not None and passes(ABSORBED, global_p(search, s.p_value), s.candidate)
    ]
    significant.sort(key=lambda s: -s.log_evidence)
    return [
        replace(s, absorbed=True)
        for rank, s in enumerate(significant, start=1)
        if passes(COMPETING, rank, s.candidate)
    ]


def _least(tangents: Tangents, bounds: list[tuple[float, Candidate]]) -> Score | None:
    """The score of least p-value among candidates of which a lower bound of it is known."""
    best, p_value = None, 1.0
    for bound, candidate in sorted(bounds, key=lambda pair: pair[0]):
        if bound >= p_value:
            break
        score_test = score(tangents, candidate)
        if score_test is not None and score_test.p_value < p_value:
            best, p_value = score_test, score_test.p_value
    return best


def trials(
    search: Search,
    explanation: Explanation,
    ranked: list[Score],
    incumbent: Candidate | None = None,
    best: float = -np.inf,
) -> list[Explanation]:
    """Explanations with one more effect, the best of every name fitted, each with the global
    p-value of its likelihood ratio, best first.

    incumbent: an effect that is known to have the log evidence `best` there, and is not fitted
    again. The likeliest name is fitted first; others are given up where they fall RACE behind it,
    or behind `best`.
    """
    fitted = cached_trials(search, explanation)
    if fitted is not None:
        news = [added_effect(explanation, trial) for trial in fitted]
        pairs = zip(fitted, news, strict=True)
        return [t for t, new in pairs if incumbent is None or _is_rival(search, new, incumbent)]
    search.journal.begin_round()
    hopeful = _hopeful_names(search, explanation, ranked) if ranked else {}
    listed = shortlist(search.journal, explanation, ranked, hopeful)
    listed += _far(search, explanation, listed)
    listed = _with_absorbed(search, explanation, listed)
    attempted = [
        s for s in listed if incumbent is None or _is_rival(search, s.candidate, incumbent)
    ]
    race = RACE.threshold

    def attempt(proposal: Score) -> Explanation | Refusal:
        if search.spent:
            return Refusal(BUDGET, search.budget_used)
        races = not search.journal.would_pass(RACE, np.inf, proposal.candidate.name)
        enough = cost_for(explanation, best - race) if races else np.inf
        trial = with_effect(search, explanation, proposal.candidate, enough, proposal.absorbed)
        if isinstance(trial, Explanation):
            whitening = trial.fit.problem.whitening
            if whitening is not explanation.fit.problem.whitening:
                whitening.forget()  # most trials are never looked at again
        return trial

    fits = [attempt(proposal) for proposal in attempted[:1]]  # what the others have to come near to
    reached = [trial.log_evidence for trial in fits if isinstance(trial, Explanation)]
    best = max([best, *reached])
    fits += in_processes(search, explanation, attempt, attempted[1:])
    fitted = []
    for proposal, trial in zip(attempted, fits, strict=True):
        if isinstance(trial, Refusal):
            search.journal.judge(trial.gate, trial.value, proposal.candidate, explanation)
            continue
        new = added_effect(explanation, trial)
        if search.starts_far(new):
            search.cache.lacks[new.name] = explanation.log_evidence - trial.log_evidence
        p_value = ratio_p_value(search, proposal, explanation, trial)
        if (behind := best - trial.log_evidence) > race:
            search.journal.judge(RACE, behind, proposal.candidate, explanation)
        fitted.append(trial.with_p_values({**trial.p_values, new.key: p_value}, proposal))
        if not trial.fit.converged:
            search.report(f"{new.name}: its fit did not come to an end")
    fitted.sort(key=lambda trial: -trial.log_evidence)
    search.cache.trials[explanation.key] = explanation.fit, fitted
    return fitted


def _is_rival(search: Search, candidate: Candidate, incumbent: Candidate) -> bool:
    """Whether a candidate may take an incumbent's place: it is another one; not of the same name
    where no tangent leads to it, as `from_far` tries all starts of a name; and no object in the
    place of a body, whose depth enough discs imitate."""
    if candidate.effect.disc and search.is_body(incumbent):
        return False
    is_same_fit = search.starts_far(candidate) and candidate.name == incumbent.name
    return candidate.key != incumbent.key and not is_same_fit


def cached_trials(search: Search, explanation: Explanation) -> list[Explanation] | None:
    """The `trials` beside an explanation; None where none were fitted."""
    fitted, fitted_trials = search.cache.trials.get(explanation.key, (None, []))
    return fitted_trials if fitted is explanation.fit else None


def _far(search: Search, explanation: Explanation, listed: list[Score]) -> list[Score]:
    """Scores of names that no tangent leads to, but for those that are listed or were far behind,
    where nobody touches: such a recording has little else to be told by."""
    names = {c.name for c in explanation.effects} | {s.candidate.name for s in listed}
    far = {c.name: c for c in search.candidates if search.starts_far(c) and c.name not in names}
    lacks, judge = search.cache.lacks, search.journal.judge
    return [
        Score(candidate, 0.0, 1, -np.inf)
        for name, candidate in far.items()
        if judge(AGAIN, lacks.get(name, 0.0), candidate, explanation)
    ]
