"""The smallest set of effects that explains a recording: forward, backward, and rivals in place.

Score tests screen every candidate; the best of every name are fitted on the nonlinear model,
jointly with all that is there. An effect enters if chance alone gives so good a score, over all
that is looked at, less than once in a thousand recordings, and if held-out frames are better
predicted by more than two standard errors. After every step each effect must stand against its
own absence; at the end against every other name in its place.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, gross, of_channels, without_site
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.noise.scoring import ScoringCache
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search import channels, resorts
from eitskin.diagnose.search.fitting import GROSS
from eitskin.diagnose.search.proposals import SIGNIFICANT, Proposals
from eitskin.diagnose.search.screen import Score, chance, choices
from eitskin.diagnose.search.start import Start
from eitskin.diagnose.search.state import State, added, per_dof
from eitskin.errors import InputError

MOST_EFFECTS = 5
LEAST_EVIDENCE = 3.0  # nats by which an effect, or a further site of one, must raise the evidence
LEAD = 1.0  # nats by which another name in an effect's place must be better
START = "start"  # the step on the path of an effect that was found before
CUT_SHORT = "cut short"  # the step on the path that says so
UNLIKE = "unlike"  # the step on the path that says so
FEW_SITES = 2  # of a sparse effect; with more, single sites are tried in its place
PLAIN = 0.5  # of the misfit without it, that a gross fault may leave


@dataclass
class Search(Proposals):
    """One recording's search. `path`: what was done, a row a step; resorts: candidates that are
    tried where the readings are not those of the skin; catalogue_p: the global p-value of the best
    candidate that did not enter the last set to which candidates were held; catalogue_of: that
    set's key."""

    resorts: list[Candidate] = field(default_factory=list)
    catalogue_p: float = 1.0
    catalogue_of: tuple | None = None
    rival_evidence: float = -np.inf
    path: list[dict] = field(default_factory=list)
    _plain: tuple[Problem, RigErrors | None] | None = None

    def run(self, start: Start | None = None, before: State | None = None) -> tuple[State, State]:
        """The state before and the state found; start: what was found on fewer frames; before: as
        of `calibrated`, where it is known."""
        before = before or self.calibrated()
        begun = self.begun(before, start) if start is not None and start.effects else None
        return self.grown(before, begun)

    def grown(self, before: State, begun: State | None = None) -> tuple[State, State]:
        """As of `run`; begun: the state that is begun with, in place of the one before."""
        state = before
        self.step("calibrate", None, state)
        if begun is not None:
            for effect in begun.effects:
                known = begun.p_value(effect) if begun.p_values else None
                self.step(START, effect, begun, known)
            if not resorts.foreign(begun.effects):
                return before, self._explained(self._drop(self._confirmed(begun)))
            found = self._drop(self._confirmed(self._blurred(begun)))
            if resorts.foreign(found.effects):
                return before, found
            self.unblur()
            self.step("not kept", None, before)
        while (plain := self._gross(state)) is not None:
            state = plain
        if self.unlike(state):
            other = self._otherwise(state)
            if other is None:
                self.step(UNLIKE, None, before)
            return before, other or before
        free = self._free_channels(state)
        if free is not None:
            self.rival_evidence = free.log_evidence
        found = self._without_freedom(state, self._explained(state))
        # What is unfinished has not lost to it.
        if free is not None and free.log_evidence > found.log_evidence and not self.spent:
            self.step("swap", free.effects[-1], free)
            self.rival_evidence = -np.inf
            found = self._explained(self._drop(free))
        return before, found

    def begun(self, before: State, start: Start) -> State | None:
        """The effects of a start fitted to all frames; None where that is no better than without
        them, or where no such skin is fitted."""
        try:
            known = fit(self.problem, start.effects, start.theta, polish=True)
            state = self.state(known, start.p_values)
        except InputError:
            return None
        if state.log_evidence <= before.log_evidence or self.unlike(state):
            return None
        return state

    def cut_short(self, state: State) -> None:
        """Puts on the path that as much was solved as may be, and that this is what there is."""
        self.report("as many skins are solved as may be: what was not tried by then stays untried")
        self.step(CUT_SHORT, None, state)

    def _explained(self, state: State) -> State:
        """What grows from `state` and stands."""
        return self._stand(self._grow(state))

    def _without_freedom(self, state: State, found: State) -> State:
        """`found`, or what grows from `state` with less freedom, where that is better: many free
        values take what several plain effects explain together. First without the names that have
        a value at every site, then, where one has several sites still, without any such subset."""
        dense = {c.name for c in found.effects if c.scope == "dense"}
        if dense and not self.spent:
            self.report(f"again without a free value at every site ({', '.join(sorted(dense))})")
            kept = [c for c in self.candidates if c.name not in dense or c.scope != "dense"]
            found = self._rival(state, found, kept)
        several = any(c.scope == "sparse" and len(c.own_sites) > FEW_SITES for c in found.effects)
        if several and not self.spent:
            self.report("again with single sites and pairs alone")
            found = self._rival(state, found, [c for c in self.candidates if c.scope != "dense"])
        return found

    def _rival(self, state: State, found: State, candidates: list[Candidate]) -> State:
        """`found`, or what grows from `state` out of other candidates, where that is better."""
        best = max(self.rival_evidence, found.log_evidence)
        plain = replace(
            self,
            candidates=candidates,
            rival_evidence=best,
            tangents=dict(self.tangents),
            met=dict(self.met),
            lesser=dict(self.lesser),
            scored={},
            trials={},
        )
        rival = plain._explained(state)
        if rival.log_evidence <= found.log_evidence:
            return found
        self.tangents, self.met, self.lesser = plain.tangents, plain.met, plain.lesser
        self.trials, self.catalogue_p = plain.trials, plain.catalogue_p
        self.catalogue_of = plain.catalogue_of
        return rival

    def _otherwise(self, state: State) -> State | None:
        """`state` with what is the last resort, where that makes its readings those of such a skin;
        None where nothing does. Nothing grows from it: what it leaves stays unexplained."""
        self.draw_null(self.linearised(state))
        found = []
        groups = list(resorts.tried(self.candidates, self.resorts))
        for group in resorts.nearest(self.rough(state), state.effects, state.fit.theta, groups):
            trial = self.from_afar(state, group, resorts.starts(group))
            if trial is None or self.unlike(trial):
                continue
            gain = 2.0 * (trial.log_likelihood - state.log_likelihood)
            p = self.global_p(chance(gain, sum(c.size for c in group)))
            trial.p_values = {**state.p_values, **{c.key: p for c in group}}
            if trial.log_evidence > state.log_evidence + LEAST_EVIDENCE:
                found.append(trial)
        if not found:
            return None
        best = self._blurred(max(found, key=lambda trial: trial.log_evidence))
        if not resorts.told(best.fit):
            self.unblur()
            return None
        for effect in best.effects[len(state.effects) :]:
            self.step("add", effect, best, best.p_values[effect.key])
        return best

    def _blurred(self, state: State) -> State:
        """A state in the noise that it would take to leave what it leaves: alike in all channels,
        in each of them a constant and scatter about it."""
        recorded = self.problem.recorded
        seen = np.isfinite(recorded).any(axis=0)
        left = (recorded - state.fit.voltage())[:, seen]
        level = np.nanmean(left, axis=0)
        constant, scatter = np.sqrt((level**2).mean()), np.sqrt(np.nanmean((left - level) ** 2))
        channels = np.ones(len(seen))
        blurred = Whitening.from_readings(recorded, scatter * channels, False, constant * channels)
        self._plain = self.problem, self.rig
        self._judge_in(replace(self.problem, whitening=blurred), None)
        fitted = fit(self.problem, state.effects, state.fit.theta, polish=True)
        return self.state(fitted, state.p_values)

    def unblur(self) -> None:
        """Back to the noise and the rig before `_blurred`, where there was one."""
        if self._plain is not None:
            self._judge_in(*self._plain)
            self._plain = None

    def _judge_in(self, problem: Problem, rig: RigErrors | None) -> None:
        """Sets in another covariance, without what is kept of the one before."""
        self.problem, self.rig, self.scoring = problem, rig, ScoringCache()
        found = self.tangents, self.met, self.lesser, self.lengths, self.scored, self.trials
        for kept in found:
            kept.clear()

    def _free_channels(self, state: State) -> State | None:
        """`state` with a gain, or an offset, of its own for every channel; None where their score
        is no better than that of plainer candidates. It is what a few plain effects must beat.
        None where nobody touches: they would fit whatever there is, and predict nothing."""
        if self.untouched:
            return None
        plain = max((s.log_evidence for s in self.scores(state)), default=0.0)
        here = self.linearised(state)
        # A discrepancy would take all of it to itself, until sizes are learned again.
        tangents = Tangents(self.named(state, here.fit), [here])
        hopeful = []
        for candidate in self.candidates:
            if of_channels(candidate):
                free = channels.scores(tangents, candidate)[-1]
                p = self.global_p(free.p_value)
                if free.log_evidence > max(plain, LEAST_EVIDENCE) and p < SIGNIFICANT:
                    hopeful.append((candidate, p))
        found = []
        trials = self.fits(state, lambda one: self.with_effect(state, one[0]), hopeful)
        for (candidate, p), trial in zip(hopeful, trials, strict=True):
            if trial is not None and trial.log_evidence > state.log_evidence:
                trial.p_values[candidate.key] = p
                found.append(trial)
        return max(found, key=lambda s: s.log_evidence, default=None)

    def _grow(self, state: State) -> State:
        """`state` with effects added until none is warranted, until what comes goes again, or until
        as many as may still come, each as good as the last, could not catch up with
        `rival_evidence`."""
        met = set()
        while len(state.effects) < MOST_EFFECTS and state.key not in met:
            met.add(state.key)
            better = self._add(state)
            if better is None:
                break
            gain = better.log_evidence - state.log_evidence
            state = self._drop(better)
            left = MOST_EFFECTS - len(state.effects)
            if self.rival_evidence - state.log_evidence > left * gain:
                break
        return state

    def _gross(self, state: State) -> State | None:
        """`state` with one gross fault of the wiring, None where none is plain to see.

        Such a fault leads the calibrations astray, and what is linear about them: each is tried
        with the beliefs as they are, one common factor free.
        """
        if self.misfit(state) < GROSS:
            return None
        recorded = self.problem.whitening(self.problem.recorded)
        start = np.zeros(len(self.problem.model.calibrations))
        chosen = state.fit.settings()
        taken = {c.key for c in state.effects}

        def left(settings: list) -> float:
            scaled = self.problem.whitening(self.problem.model.voltage(start, settings))
            return float((recorded**2).sum() - (scaled * recorded).sum() ** 2 / (scaled**2).sum())

        faults = [c for c in self.candidates if gross(c)]
        trials = [
            (left([*chosen, c.setting(np.zeros(c.size))]), i)
            for i, c in enumerate(faults)
            if c.key not in taken
        ]
        least, best = min(trials)
        if least > PLAIN * left(chosen):
            return None
        effects = [*state.effects, faults[best]]
        size = sum(c.size for c in effects)
        found = self.state(fit(self.problem, effects, np.r_[start, np.zeros(size)], polish=True))
        if found.log_evidence < state.log_evidence + LEAST_EVIDENCE:
            return None
        self.draw_null(self.linearised(found))
        gain = 2.0 * (found.log_likelihood - state.log_likelihood)
        p = self.global_p(chance(gain, 1 + faults[best].size))
        found = self.settled(found)
        found.p_values = {**state.p_values, faults[best].key: p}
        self.step("add", faults[best], found, p)
        return found

    def _add(self, state: State) -> State | None:
        """The state with one more effect, None where none is warranted."""
        scores = self.scores(state)
        if not scores:
            return None
        p_value = self.catalogue_p = self.global_p(min(s.p_value for s in scores))
        self.catalogue_of = state.key
        self.report(
            f"{len(state.effects)} effects, chi2/dof {per_dof(state):.3f}: best score "
            f"{scores[0].candidate.name}, of which p = {p_value:.2g}"
        )
        if self.spent:
            return None
        for trial in self.tried(state, scores):
            if trial.log_evidence < state.log_evidence + LEAST_EVIDENCE:
                break
            new = added(state, trial)
            p = trial.p_values[new.key]
            if p >= SIGNIFICANT:
                continue
            if self.predicts(trial, state) and self._needed(trial, new):
                trial.p_values = {**state.p_values, new.key: p}
                self.step("add", new, trial, p)
                return trial
        return None

    def _needed(self, trial: State, new: Candidate) -> bool:
        """Whether a trial is better than without its new effect, where touches were followed: on
        its way to where they seem to be it may have found what the state before had not."""
        if trial.fit.problem.model is self.problem.model:
            return True
        less = self.without(trial, trial.effects.index(new))
        assert trial.score is not None
        p = self.own_p(trial.score, less, trial)
        return p < SIGNIFICANT and trial.log_evidence > less.log_evidence + LEAST_EVIDENCE

    def renew_catalogue_p(self, state: State) -> None:
        """`catalogue_p` of a state, where it is another's."""
        if state.key != self.catalogue_of and not (self.spent or self.unlike(state)):
            scores = self.scores(state)
            self.catalogue_p = self.global_p(min((s.p_value for s in scores), default=1.0))
            self.catalogue_of = state.key

    def _confirmed(self, state: State) -> State:
        """A state that was found before, less the effects that all frames do not bear out, each
        with the p-value of its likelihood ratio on all of them."""
        self.draw_null(self.linearised(state))
        while True:
            for index, less in self.each_without(state, len(state.effects)):
                effect = state.effects[index]
                gain = max(2.0 * (state.log_likelihood - less.log_likelihood), 0.0)
                one = Score(effect, gain, max(effect.size, 1), 0.0, _choices(effect))
                p = self.global_p(one.p_value)
                worth = state.log_evidence >= less.log_evidence + LEAST_EVIDENCE
                if not (worth and p < SIGNIFICANT and self.predicts(state, less)):
                    self.step("drop", effect, less, p)
                    state = less
                    break
                state.p_values[effect.key] = p
            else:
                return state

    def _drop(self, state: State) -> State:
        """Effects that no longer earn their place, taken out one by one; the rest polished."""
        dropped = True
        while dropped and len(state.effects) > 1:
            dropped = False
            for index, less in self.each_without(state, len(state.effects) - 1):
                if less.log_evidence > state.log_evidence - LEAST_EVIDENCE:
                    self.step("drop", state.effects[index], less)
                    state, dropped = less, True
                    break
        state = self._trim(state)
        return self.state(self.polished(state.fit), state.p_values, state.sizes, state.rig)

    def _trim(self, state: State) -> State:
        """Sites of sparse effects that do not earn their place, taken out one by one."""
        for index in range(len(state.effects)):
            effect = state.effects[index]
            if effect.effect.site_number:
                continue
            while effect.scope == "sparse" and effect.size == len(effect.own_sites) > 1:
                place = state.fit.place(index)
                sd = np.sqrt(np.diag(state.fit.covariance)[place])
                weakest = int(np.argmin(np.abs(state.fit.theta[place]) / sd))
                fewer = without_site(effect, weakest)
                effects = [*state.effects[:index], fewer, *state.effects[index + 1 :]]
                theta = np.delete(state.fit.theta, place.start + weakest)
                jacobian = np.delete(state.fit.jacobian, place.start + weakest, axis=0)
                try:
                    fitted = fit(state.fit.problem, effects, theta, jacobian)
                except InputError:
                    break
                trial = self.state(fitted, state.p_values, state.sizes, state.rig)
                if trial.log_evidence <= state.log_evidence - LEAST_EVIDENCE:
                    break
                trial.p_values[fewer.key] = state.p_values.get(effect.key, 1.0)
                state, effect = trial, fewer
        return state

    def _stand(self, state: State) -> State:
        """Every effect against every other name in its place, until none gives way, or one takes
        the place back that it lost: the likeliest of the sets between which that goes on then."""
        if self.rival_evidence > state.log_evidence:
            return state
        stood = [state]
        for _ in range(MOST_EFFECTS):
            for index, effect in enumerate(state.effects):
                if gross(effect) or self.spent:
                    continue
                less = self.less(state, index)
                rivals = self.tried(less, self.scores(less), effect, state.log_evidence)
                ahead = (
                    rival
                    for rival in rivals
                    if rival.log_evidence > state.log_evidence + _lead(effect, rival.effects[-1])
                    and self.predicts(rival, less)
                )
                better = next(ahead, None)
                if better is not None:
                    new = added(less, better)
                    p = better.p_values[new.key]
                    better.p_values = {**state.p_values, new.key: p}
                    self.step("swap", new, better, p)
                    state = self._grow(self._drop(better))
                    break
            else:
                return state
            stood.append(state)
            same = [i for i, s in enumerate(stood) if set(s.key) == set(state.key)]
            if len(same) > 1:
                best = max(reversed(stood[same[0] :]), key=lambda s: s.log_evidence)
                if best is not state:
                    self.step("take back", None, best)
                return best
        return state

    def step(
        self, action: str, effect: Candidate | None, state: State, p: float | None = None
    ) -> None:
        """Puts on the path what was done with an effect, and the state by then."""
        self.path.append(
            {
                "step": len(self.path),
                "action": action,
                "effect": effect.name if effect else "",
                "sites": " ".join(map(str, effect.sites)) if effect and effect.sites else "",
                "chi2": state.fit.chi2,
                "log_evidence": state.log_evidence,
                "p_value": p,
            }
        )


def _choices(effect: Candidate) -> int:
    """Among how many an effect that is there was chosen, as of `Score`."""
    if effect.effect.tone:
        return effect.looks
    few = effect.scope == "sparse" and len(effect.own_sites) > 1
    return choices(effect) if few else 1


def _lead(effect: Candidate, rival: Candidate) -> float:
    """Nats by which a rival must be ahead of an effect to take its place: where it is the same at
    further sites, what every site must earn."""
    sparse = effect.scope == rival.scope == "sparse" and rival.name == effect.name
    if sparse and set(rival.own_sites) > set(effect.own_sites):
        return LEAST_EVIDENCE * (len(rival.own_sites) - len(effect.own_sites))
    return LEAD
