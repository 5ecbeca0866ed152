"""What may come next beside a set of effects: scores of all candidates, the best of every name
fitted."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from eitskin import cores
from eitskin.diagnose.fitting.candidates import Candidate, discrete, of_channels, of_tangents
from eitskin.diagnose.fitting.fit import Fit, whitened_anew
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.search import afar, channels, tones
from eitskin.diagnose.search.fitting import GROSS, Fitting
from eitskin.diagnose.search.screen import Null, Score, best_few, chance, null, score
from eitskin.diagnose.search.shortlist import shortlist
from eitskin.diagnose.search.state import State, added

SIGNIFICANT = 1e-3
# Trials are fitted where the best score has this global p-value, or this log evidence ...
WORTH_TRYING, HOPE = 0.05, 1.0
COMPETING = 2  # ... and so many of the names that an error of the rig may have taken to itself
STARTS = 3  # of a name, no two of one depth or height, from which it is fitted from afar
FAR = 16.0  # times chi squared: a change of so great a squared length cannot lower it
RACE = 10.0  # nats behind the best trial at which another is given up


@dataclass
class Proposals(Fitting):
    """What may come next beside a set. seed: of the recordings in which nothing is missing; report:
    called with words; scored, trials: of sets by their keys, each with the fit that they are
    about."""

    seed: int = field(kw_only=True)
    report: Callable[[str], None] = field(kw_only=True)
    null: Null | None = None
    lengths: dict[tuple, float] = field(default_factory=dict)
    scored: dict[tuple, tuple[Fit, list[Score]]] = field(default_factory=dict)
    trials: dict[tuple, tuple[Fit, list[State]]] = field(default_factory=dict)

    def scores(self, state: State) -> list[Score]:
        """Every candidate's score about a state, the best evidence first; kept."""
        whole, found = self.scored.get(state.key, (None, []))
        if whole is not state.fit:
            found = self._scores(state, self.linearised(state))
            self.scored[state.key] = state.fit, found
        return found

    def _scores(self, state: State, tangents: Tangents) -> list[Score]:
        taken = {c.key for c in state.effects}
        # So far off with effects in it, a set wants more than any few channels.
        hopeless = bool(state.effects) and not self.untouched and self.misfit(state) > GROSS
        found: list[Score | None] = []
        open_to = [c for c in self.candidates if c.key not in taken and not self.starts_afar(c)]
        tangents.whiten(c for c in open_to if of_tangents(c))
        there = [c for c in open_to if discrete(c) and not of_channels(c)]
        found += self._tried(tangents, there)
        for candidate in open_to:
            if of_channels(candidate):
                scored = channels.scores(tangents, candidate)
                found += [s for s in scored if s.candidate.scope == "sparse" or hopeless]
            elif candidate.effect.tone:
                found.append(
                    tones.score(tangents, candidate.effect, candidate.skin, candidate.scales)
                )
            elif not discrete(candidate):
                found.append(score(tangents, candidate))
                if candidate.scope == "dense":
                    found.append(best_few(tangents, candidate))
        self.draw_null(tangents)
        return sorted((s for s in found if s is not None), key=lambda s: -s.log_evidence)

    def draw_null(self, tangents: Tangents) -> None:
        """`null`, once: score tests of single candidates are drawn; those of channels, of discrete
        candidates and tones, and of the best few of each dense one are counted."""
        if self.null is not None:
            return
        linear, free = [], 0
        for candidate in self.candidates:
            if of_tangents(candidate):
                linear.append(candidate)
                free += candidate.scope == "dense"
            else:
                free += channels.looks(candidate) if of_channels(candidate) else 1
        self.report("drawing recordings in which nothing is missing")
        tangents.whiten(linear)
        self.null = null(tangents, linear, free, self.seed)

    def global_p(self, local: float) -> float:
        """How often chance alone gives one look's p-value of `local` or less, over all that is
        looked at."""
        assert self.null is not None
        return self.null.p_value(local)

    def _tried(self, tangents: Tangents, candidates: list[Candidate]) -> list[Score]:
        """Candidates without tangents, by trying them; the calibrations follow to first order. One
        with coordinates counts at the size at which it fits best: a fit finds it. Left out are
        those that change nothing, or far too much."""

        def tried(some: list[Candidate]) -> dict[tuple, tuple[float, float]]:
            changes = [(candidate.key, tangents.tried(candidate)) for candidate in some]
            return {
                key: (float(c @ c), float(c @ tangents.residual))
                for key, c in changes
                if c is not None
            }

        far = FAR * tangents.fit.chi2
        near = [c for c in candidates if self.lengths.get(c.key, 0.0) <= far]
        known: dict[tuple, tuple[float, float]] = {}
        shares = cores.shares([candidate] for candidate in near)
        for own in self.problem.model.near.forked(tried, shares):
            known |= own
        found = []
        for candidate in near:
            if candidate.key not in known:
                continue
            length, along = known[candidate.key]
            self.lengths[candidate.key] = length
            if length == 0.0:
                continue
            gain = 2.0 * along - length
            if candidate.size and along > 0:
                gain = along**2 / length
            found.append(Score(candidate, gain, 1, 0.5 * gain - np.log(candidate.looks)))
        return found

    def _hopeful(self, scores: list[Score]) -> bool:
        """Whether the best score is surprising enough for trials to be worth their fits."""
        p = self.global_p(min(s.p_value for s in scores))
        return p < WORTH_TRYING or scores[0].log_evidence > HOPE

    def _competing(self, state: State, known: set[str]) -> list[Score]:
        """The best scores of names that would be significant if what one of the rig's errors has
        taken to itself were open, but for `known` ones: until sizes are learned again, what is
        alike in all presses is the rig's too."""
        found: dict[str, Score] = {}
        for name in state.sizes:
            if state.sizes[name] > 0.0 and not COMPONENTS[name].discrepancy:
                for one in self._without_component(state, name, known):
                    found.setdefault(one.candidate.name, one)
        return list(found.values())

    def _without_component(self, state: State, name: str, known: set[str]) -> list[Score]:
        """The best scores of COMPETING names where a component is none of the covariance. Without
        it a candidate's information is no less, so that the score with it bounds that without."""
        assert state.rig is not None
        here = self.linearised(state)
        whitening = state.rig.whitening({**state.sizes, name: 0.0}, fitted=True)
        problem = replace(here.fit.problem, whitening=whitening)
        tangents = Tangents(whitened_anew(here.fit, problem), [here])
        weights = whitening.transposed(tangents.residual.reshape(tangents.voltage.shape)).ravel()
        bounds: dict[str, list[tuple[float, Candidate]]] = {}
        for one in self.scores(state):
            own = one.candidate
            if own.name in known or own.scope == "dense" or one.information is None:
                continue
            slope = tangents.along(own, weights)
            p = chance(float(slope @ np.linalg.pinv(one.information) @ slope), one.dof)
            if self.global_p(p) < SIGNIFICANT:
                bounds.setdefault(own.name, []).append((p, own))
        least = [_least(tangents, own) for own in bounds.values()]
        found = [s for s in least if s is not None and self.global_p(s.p_value) < SIGNIFICANT]
        return sorted(found, key=lambda s: -s.log_evidence)[:COMPETING]

    def own_p(self, score: Score, state: State, trial: State) -> float:
        """Global p-value of what a trial has beyond a state: its likelihood ratio's (Wilks 1938),
        the sizes of the rig's errors learned for both."""
        gain = 2.0 * (trial.log_likelihood - state.log_likelihood)
        dof = max(score.dof, len(trial.fit.theta) - len(state.fit.theta))
        return self.global_p(replace(score, gain=max(gain, 0.0), dof=dof).p_value)

    def tried(
        self,
        state: State,
        scores: list[Score],
        known: Candidate | None = None,
        best: float = -np.inf,
    ) -> list[State]:
        """States with one more effect, the best of every name fitted, each with the global p-value
        of its likelihood ratio, as of `own_p`, best first; but for one that is `known` to have the
        log evidence `best`. The likeliest is fitted first; the others are given up where they fall
        RACE behind it, or behind `best`."""
        there = self.tried_beside(state)
        if there is not None:
            return there
        listed = shortlist(scores) if self._hopeful(scores) else []
        listed += self._afar(state, listed)
        competing = self._competing(state, {s.candidate.name for s in listed})

        def attempt(one: Score) -> State | None:
            if self.spent:
                return None
            trial = self.with_effect(state, one.candidate, self.cost(state, best - RACE))
            if trial is not None:
                own = trial.fit.problem.whitening
                if own is not state.fit.problem.whitening:
                    own.forget()  # most trials are never looked at again
            return trial

        taken = known and known.key
        open_to = [s for s in [*listed, *competing] if s.candidate.key != taken]
        trials = [attempt(one) for one in open_to[:1]]  # what the others have to come near to
        best = max([best, *(one.log_evidence for one in trials if one is not None)])
        trials += self.fits(state, attempt, open_to[1:])
        found: list[State] = []
        for s, trial in zip(open_to, trials, strict=True):
            if trial is not None:
                trial.score = s
                new = added(state, trial)
                trial.p_values[new.key] = self.own_p(s, state, trial)
                found.append(trial)
                if not trial.fit.ended:
                    self.report(f"{new.name}: its fit did not come to an end")
        found.sort(key=lambda s: -s.log_evidence)
        self.trials[state.key] = state.fit, found
        return found

    def tried_beside(self, state: State) -> list[State] | None:
        """What `tried` has found beside a state; None where nothing was tried."""
        whole, found = self.trials.get(state.key, (None, []))
        return found if whole is state.fit else None

    def _afar(self, state: State, listed: list[Score]) -> list[Score]:
        """Scores of candidates that no tangent leads to, but for `listed` ones, where nobody
        touches: such a recording has little else to be told by. Of every name the few that begin
        nearest to the readings."""
        there = {c.name for c in state.effects} | {s.candidate.name for s in listed}
        problem = self.rough(state)
        left: dict[str, dict] = {}
        for candidate in self.candidates:
            if not self.starts_afar(candidate) or candidate.name in there:
                continue
            misfit, _ = afar.start(problem, state.effects, state.fit.theta, [candidate])
            own, first = (
                left.setdefault(candidate.name, {}),
                next(iter(candidate.start.items()), ()),
            )
            if misfit < own.get(first, (np.inf, candidate))[0]:
                own[first] = misfit, candidate
        return [
            Score(candidate, 0.0, 1, -np.inf)
            for own in left.values()
            for _, candidate in sorted(own.values(), key=lambda pair: pair[0])[:STARTS]
        ]


def _least(tangents: Tangents, bounds: list[tuple[float, Candidate]]) -> Score | None:
    """The score of least p-value among candidates of which a lower bound of it is known."""
    best, least = None, 1.0
    for bound, candidate in sorted(bounds, key=lambda pair: pair[0]):
        if bound >= least:
            break
        one = score(tangents, candidate)
        if one is not None and one.p_value < least:
            best, least = one, one.p_value
    return best
