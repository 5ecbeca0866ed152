"""What is tried where readings are not those of the skin that is believed: another instrument than
its owner's, alone and with what it calls for."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Fit, Problem, fit
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search import far_starts
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import EVIDENCE, SIZE
from eitskin.diagnose.search.prediction import is_unlike
from eitskin.diagnose.search.proposals import draw_null, global_p
from eitskin.diagnose.search.refits import explain, from_far, linearised, rough
from eitskin.diagnose.search.screen import chance_p_value
from eitskin.diagnose.search.search import Search


def size_sd(fitted: Fit) -> float:
    """Largest sd of the logarithm of a last resort's size in a fit; 0 where it has none."""
    sd = np.sqrt(np.diag(fitted.covariance))
    indices = [i for i, c in enumerate(fitted.effects) if c.effect.last_resort]
    return max(
        (float(sd[fitted.coordinate_slice(i)].max(initial=0.0)) for i in indices), default=0.0
    )


def groups(candidates: list[Candidate], resorts: list[Candidate]) -> Iterator[list[Candidate]]:
    """Each of the last resorts, then it with the candidates that may come with it, as large as they
    may be there."""
    for resort in resorts:
        companions = resort.effect.last_resort
        large = [
            replace(c, scales=replace(c.scales, multiple=companions[c.name][0]))
            for c in [resort, *candidates]
            if c.name in companions and c.scope in ("", "common")
        ]
        yield from (large[:count] for count in range(1, len(large) + 1))


def start_coordinates(group: list[Candidate]) -> list[tuple[float, ...]]:
    """The coordinates from which fits of a group begin."""
    companions = group[0].effect.last_resort
    return list(product(*(companions[candidate.name][1] for candidate in group)))


def nearest(
    problem: Problem,
    effects: list[Candidate],
    theta: np.ndarray,
    candidate_groups: list[list[Candidate]],
) -> list[list[Candidate]]:
    """Of the groups of the same names, beside effects at theta (P,), the one that begins nearest to
    the readings."""
    best: dict[tuple, tuple[float, list[Candidate]]] = {}
    for group in candidate_groups:
        chi2, _ = far_starts.start(problem, effects, theta, group, start_coordinates(group))
        names = tuple(candidate.name for candidate in group)
        if chi2 < best.get(names, (np.inf,))[0]:
            best[names] = chi2, group
    return [group for _, group in best.values()]


def another_instrument(
    search: Search, explanation: Explanation
) -> tuple[Search, Explanation | None]:
    """An explanation with what is the last resort, where that makes the readings those of such a
    skin, and the search in its covariance; None where nothing does. Nothing grows from it: what it
    leaves stays unexplained."""
    draw_null(search, linearised(search, explanation))
    better = []
    problem = rough(search, explanation)
    candidate_groups = list(groups(search.candidates, search.last_resorts))
    for group in nearest(problem, explanation.effects, explanation.fit.theta, candidate_groups):
        trial = from_far(search, explanation, [group], start_coordinates(group))
        if not isinstance(trial, Explanation):
            search.journal.judge(trial.gate, trial.value, group[0], explanation)
            continue
        if is_unlike(search, trial):
            continue
        gain = 2.0 * (trial.log_likelihood - explanation.log_likelihood)
        p = global_p(search, chance_p_value(gain, sum(c.size for c in group)))
        p_values = {**explanation.p_values, **{c.key: p for c in group}}
        raised = trial.log_evidence - explanation.log_evidence
        if search.journal.judge(EVIDENCE, raised, group[0], explanation):
            better.append(trial.with_p_values(p_values))
    if not better:
        return search, None
    in_blur, best = blurred(search, max(better, key=lambda trial: trial.log_evidence))
    resort = best.effects[len(explanation.effects)]
    if not search.journal.judge(SIZE, size_sd(best.fit), resort, explanation):
        return in_blur.restored(), None
    for effect in best.effects[len(explanation.effects) :]:
        search.journal.step("add", effect, best, best.p_values[effect.key])
    return in_blur, best


def blurred(search: Search, explanation: Explanation) -> tuple[Search, Explanation]:
    """A search, and its explanation, in the noise that it would take to leave what the explanation
    leaves: alike in all channels, in each of them a constant and scatter about it."""
    recorded = search.problem.readings
    recorded_channels = np.isfinite(recorded).any(axis=0)
    residual = (recorded - explanation.fit.voltage())[:, recorded_channels]
    level = np.nanmean(residual, axis=0)
    constant = np.sqrt((level**2).mean())
    scatter = np.sqrt(np.nanmean((residual - level) ** 2))
    unit = np.ones(recorded.shape[1])
    whitening = Whitening.from_readings(recorded, scatter * unit, False, constant * unit)
    unblurred = search.problem, search.rig
    search = search.in_covariance(replace(search.problem, whitening=whitening), None)
    search = replace(search, unblurred=unblurred)
    start = explanation.fit.theta
    fitted = fit(search.problem, explanation.effects, start, polish=True)
    return search, explain(search, fitted, explanation.p_values)
