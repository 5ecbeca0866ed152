"""The smallest set of effects that explains a recording: forward, backward, and rivals in place.

Score tests screen every candidate; the best of every name are fitted on the nonlinear model,
jointly with all that is there. An effect enters if chance alone gives so good a score, over all
that is looked at, less than once in a thousand recordings, and if held-out frames are better
predicted by more than two standard errors. After every step each effect must stand against its
own absence; at the end against every other name in its place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from eitskin import cores
from eitskin.diagnose import touches
from eitskin.diagnose.candidates import (
    Candidate,
    discrete,
    gross,
    of_channels,
    of_tangents,
    without_site,
)
from eitskin.diagnose.fit import (
    MOST_ROUNDS,
    RENEWALS,
    Fit,
    Problem,
    fit,
    promised,
    refreshed,
    stepped,
    whitened_anew,
)
from eitskin.diagnose.held_out import HeldOut, held_out
from eitskin.diagnose.rig import COMPONENTS, Rig
from eitskin.diagnose.rig_sizes import SETTLED, KeptScoring, learned
from eitskin.diagnose.search import afar, channels, resorts, tones
from eitskin.diagnose.search.screen import (
    Null,
    Score,
    best_few,
    chance,
    choices,
    null,
    score,
)
from eitskin.diagnose.search.shortlist import shortlist
from eitskin.diagnose.search.state import State, added, likelihood, occam, per_dof
from eitskin.diagnose.tangents import Tangents
from eitskin.diagnose.whitening import Whitening
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.physics.solver import Spent

Part = TypeVar("Part")
Result = TypeVar("Result")

SIGNIFICANT = 1e-3
# Trials are fitted where the best score has this global p-value, or this log evidence ...
WORTH_TRYING, HOPE = 0.05, 1.0
COMPETING = 2  # ... and so many of the names that an error of the rig may have taken to itself
STANDARD_ERRORS = 2.0
MOST_EFFECTS = 5
LEARNED = 4  # times at most that sizes of rig errors and a fit follow each other
LEAST_EVIDENCE = 3.0  # nats by which an effect, or a further site of one, must raise the evidence
LEAD = 1.0  # nats by which another name in an effect's place must be better
MOST_SOLVED = 16_000  # sheets, of one diagnosis
UNEXPLAINED = "static-discrepancy"  # the component of a value a channel
START = "start"  # the step on the path of an effect that was found on fewer frames
CUT_SHORT = "cut short"  # the step on the path that says so
ALIKE = 0.3  # squared correlation with the simulation, from which on names are looked for
UNLIKE = "unlike"  # the step on the path that says so
FEW_SITES = 2  # of a sparse effect; with more, single sites are tried in its place
MOST_JOINED = 8  # sites of an effect that is still called sparse
# Of the readings: what a fit from afar may leave at most, to begin with, and at least, for bodies
# are solved coarsely there.
AFAR, COARSE = 0.05, 3e-4
STARTS = 3  # of a name, no two of one depth or height, from which it is fitted from afar
FAR = 16.0  # times chi squared: a change of so great a squared length cannot lower it
GROSS = 30.0  # chi squared over its degrees of freedom above which gross faults are tried first
PLAIN = 0.5  # of the misfit without it, that a gross fault may leave
RACE = 10.0  # nats behind the best trial at which another is given up
# A fit without its discrepancy that is so many nats behind after one step, with what the next one
# promises, is given up, unless chi squared says that it is far off (GROSS).
FORLORN = 150.0
LOST = 100.0  # nats behind the state that it began from: a fit that went astray
TOGETHER = 4  # fits in processes of their own, of which none knows what the others solve


@dataclass
class Search:
    """One recording's search. problem: with noise alone in its covariance; rigged: whether a rig
    may add to it, converter_step: as `step` of `Noise`; rig: what it may add. `path`: what was
    done, a row a step; report: called with words; share: of all that a diagnosis may solve, with
    which this ends; resorts: candidates that are tried where the readings are not those of the
    skin; catalogue_p: the global p-value of the best candidate that did not enter the last set to
    which candidates were held; catalogue_of: that set's key."""

    problem: Problem
    candidates: list[Candidate]
    fold: np.ndarray
    seed: int
    report: Callable[[str], None]
    share: float = 1.0
    resorts: list[Candidate] = field(default_factory=list)
    rigged: bool = False
    converter_step: float = 0.0
    rig: Rig | None = None
    catalogue_p: float = 1.0
    catalogue_of: tuple | None = None
    rival_evidence: float = -np.inf
    path: list[dict] = field(default_factory=list)
    null: Null | None = None
    tangents: dict[tuple, Tangents] = field(default_factory=dict)
    met: dict[tuple, State] = field(default_factory=dict)
    lesser: dict[tuple, tuple[Fit, State]] = field(default_factory=dict)
    lengths: dict[tuple, float] = field(default_factory=dict)
    scored: dict[tuple, list[Score]] = field(default_factory=dict)
    trials: dict[tuple, list[State]] = field(default_factory=dict)
    scoring: KeptScoring = field(default_factory=KeptScoring, repr=False)
    _plain: tuple[Problem, Rig | None] | None = None

    @property
    def most_solved(self) -> float:
        """Sheets after which nothing more is tried for its own sake."""
        return self.share * MOST_SOLVED

    @property
    def untouched(self) -> bool:
        """Whether nobody touches: folds are of channels then."""
        return self.fold.ndim == 2

    def starts_afar(self, candidate: Candidate) -> bool:
        """Whether no tangent leads to a candidate, so that its fits begin as of `afar`."""
        return self.untouched and afar.is_far(candidate)

    @property
    def spent(self) -> bool:
        """Whether the search has taken so long that it ends with what it has."""
        return self.problem.model.near.spent > self.most_solved

    def state(
        self,
        fitted: Fit,
        p_values: dict | None = None,
        sizes: dict[str, float] | None = None,
        rig: Rig | None = None,
    ) -> State:
        """A fit with its evidence and held-out density; sizes: those of the rig's errors that it
        has, from which they are learned; rig: these errors about a fit like it. A discrepancy may
        have taken what an effect has to explain: what the fit makes of it without one counts if
        that is likelier; it is not tried where it is FORLORN."""
        found = self._learned_state(fitted, p_values, sizes, rig, self.scoring)
        named = self.named(found, found.fit)
        if named is found.fit:
            return found
        own = {k: s for k, s in found.sizes.items() if not COMPONENTS[k].discrepancy}
        moved = stepped(named)
        behind = found.log_likelihood - likelihood(moved, own, found.rig) - 0.5 * promised(moved)
        if moved is not named and behind > FORLORN and self._misfit(found) < GROSS:
            return found
        other = self._learned_state(moved, p_values, own, found.rig)
        return found if other.log_evidence <= found.log_evidence else other

    def _learned_state(
        self,
        fitted: Fit,
        p_values: dict | None,
        sizes: dict[str, float] | None,
        rig: Rig | None,
        kept: KeptScoring | None = None,
    ) -> State:
        sizes, rig = dict(sizes or {}), rig or self.rig
        if rig is not None:
            ended = KeptScoring()
            for number in range(LEARNED):
                scorings = (kept or ended) if number == 0 else ended, ended
                fitted, sizes, rig, gained = self._learned(fitted, sizes, rig, *scorings)
                if gained < SETTLED:
                    break
        found = likelihood(fitted, sizes, rig)
        evidence = found + occam(fitted)
        return State(fitted, self.fold, found, evidence, dict(p_values or {}), sizes, rig)

    def _learned(
        self,
        fitted: Fit,
        sizes: dict[str, float],
        rig: Rig,
        kept: KeptScoring,
        ended: KeptScoring,
    ) -> tuple[Fit, dict[str, float], Rig, float]:
        """A fit with the sizes of the rig's errors learned from it, and by how many nats it moved
        on for them; kept, ended: as of `learned`. Where touches are far from where they are said to
        be, the readings are taken to follow in proportion from where they seem to be (Lindstrom,
        Bates, Biometrics 46, 1990)."""
        sizes, _ = learned(rig, fitted.misfit, sizes, kept, ended)
        there, problem = touches.followed(self.problem, fitted, rig, sizes), fitted.problem
        followed = there is not problem.model
        if followed:
            moved = replace(fitted, problem=replace(self.problem, model=there))
            rig = Rig.about(moved, self.problem.whitening, self.converter_step)
            strays = touches.moved(there, self.problem.model)
            recorded = self.problem.recorded + rig.followed(strays)
            problem = replace(self.problem, model=there, recorded=recorded)
        problem = replace(problem, whitening=rig.whitening(sizes, fitted=True))
        here = whitened_anew(fitted, problem)
        moved = stepped(here, 2.0 * SETTLED)
        gained = np.inf if followed else 0.5 * (here.cost - moved.cost)
        return moved, sizes, rig, gained

    def _fits(
        self, state: State, of: Callable[[Part], Result], parts: Sequence[Part]
    ) -> list[Result]:
        """A function of every part, which fits something about a state, each in a process of its
        own: what it changes in this search but its result is lost. Each may solve all that may
        still be solved, TOGETHER of them; then what they solved counts. One after the other in this
        process where bodies are tried, of which two at once take too much memory."""
        if len(parts) < 2 or any(c.name == "third-dimension" for c in self.candidates):
            return [of(part) for part in parts]
        if state.rig is not None:
            self.scoring.prepare(state.rig, state.sizes)
        shared: list[object] = [*EFFECTS.values(), *state.effects]
        shared += [self.fold, self.rig, state.rig]
        for problem in (self.problem, state.fit.problem):
            own = problem.whitening
            shared += [problem, *vars(problem).values(), *vars(problem.model).values()]
            shared += [own.mask, own.sd, own.rho, own.clock]
        found: list[Result] = []
        for start in range(0, len(parts), TOGETHER):
            together = parts[start : start + TOGETHER]
            found += self.problem.model.near.forked(of, together, shared)
        return found

    def calibrated(self) -> State:
        """The owner's beliefs with their calibrations fitted, no effect."""
        start = np.zeros(len(self.problem.model.calibrations))
        best = fit(self.problem, [], start, polish=True)
        if self.rigged and self.rig is None:
            self.rig = Rig.about(best, self.problem.whitening, self.converter_step)
        near = self.state(best)
        far = self._from_afar(near, []) if self.rigged and self.untouched else None
        return near if far is None or far.log_evidence <= near.log_evidence else far

    def as_reported(self, fitted: Fit) -> np.ndarray:
        """(N, M): what a fit has for the touches where they are said to be."""
        return self.problem.model.voltage(*self.problem.split(fitted.theta, fitted.effects))

    def named(self, state: State, fitted: Fit) -> Fit:
        """A fit of a state without a discrepancy in its covariance."""
        kept = {n: s for n, s in state.sizes.items() if not COMPONENTS[n].discrepancy}
        if state.rig is None or sum(kept.values()) == sum(state.sizes.values()):
            return fitted
        whitening = state.rig.whitening(kept, fitted=True)
        return whitened_anew(fitted, replace(fitted.problem, whitening=whitening))

    def settled(self, state: State) -> State:
        """A state whose rig is seen about its own fit, with its sizes learned once more."""
        if self.rig is None:
            return state
        self.rig = Rig.about(state.fit, self.problem.whitening, self.converter_step)
        fitted = fit(state.fit.problem, state.effects, state.fit.theta, polish=True)
        return self.state(fitted, state.p_values, state.sizes)

    def run(self, start: State | None = None) -> tuple[State, State]:
        """The state before and the state found; start: what was found on fewer frames."""
        before = state = self.calibrated()
        self.step("calibrate", None, state)
        if start is not None and start.effects:
            begun = self._begun(before, start)
            if begun is not None and resorts.foreign(begun.effects):
                found = self._drop(self._confirmed(self._blurred(begun)))
                if resorts.foreign(found.effects):
                    return before, found
                self.unblur()
                self.step("not kept", None, before)
            elif begun is not None:
                return before, self._explained(self._drop(self._confirmed(begun)))
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

    def _begun(self, before: State, start: State) -> State | None:
        """The effects of a start fitted to all frames; None where that is no better than without
        them, or where no such skin is fitted."""
        try:
            known = fit(self.problem, start.effects, start.fit.theta, polish=True)
            state = self.state(known, start.p_values)
        except InputError:
            return None
        if state.log_evidence <= before.log_evidence or self.unlike(state):
            return None
        for effect in state.effects:
            self.step(START, effect, state, state.p_value(effect))
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
        plain = replace(self, candidates=candidates, rival_evidence=best, scored={}, trials={})
        rival = plain._explained(state)
        if rival.log_evidence <= found.log_evidence:
            return found
        self.trials, self.catalogue_p = plain.trials, plain.catalogue_p
        self.catalogue_of = plain.catalogue_of
        return rival

    def _otherwise(self, state: State) -> State | None:
        """`state` with what is the last resort, where that makes its readings those of such a skin;
        None where nothing does. Nothing grows from it: what it leaves stays unexplained."""
        self._draw_null(self.linearised(state))
        found = []
        groups = list(resorts.tried(self.candidates, self.resorts))
        for group in resorts.nearest(self.rough(state), state.effects, state.fit.theta, groups):
            trial = self._from_afar(state, group, resorts.starts(group))
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
        blurred = Whitening.of(recorded, scatter * channels, False, constant * channels)
        self._plain = self.problem, self.rig
        self._judge_in(replace(self.problem, whitening=blurred), None)
        fitted = fit(self.problem, state.effects, state.fit.theta, polish=True)
        return self.state(fitted, state.p_values)

    def unblur(self) -> None:
        """Back to the noise and the rig before `_blurred`, where there was one."""
        if self._plain is not None:
            self._judge_in(*self._plain)
            self._plain = None

    def _judge_in(self, problem: Problem, rig: Rig | None) -> None:
        """Sets in another covariance, without what is kept of the one before."""
        self.problem, self.rig, self.scoring = problem, rig, KeptScoring()
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
        trials = self._fits(state, lambda one: self.with_effect(state, one[0]), hopeful)
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

    def linearised(self, state: State) -> Tangents:
        """Tangents about a state, kept until its set is fitted anew; their whitened columns until
        those of another set are asked for."""
        key = state.key
        if key not in self.met or self.met[key].fit is not state.fit:
            strayed = state.fit.problem.model is not self.problem.model
            fitted = refreshed(state.fit) if strayed else state.fit
            self.tangents[key] = Tangents(fitted, reversed(self.tangents.values()))
            self.met[key] = state
            for kept in (self.scored, self.trials):
                kept.pop(key, None)
        found = self.tangents[key]
        for other in self.tangents.values():
            if other is not found:
                other.forget()
        return found

    def scores(self, state: State) -> list[Score]:
        """Every candidate's score about a state, the best evidence first; kept."""
        key, tangents = state.key, self.linearised(state)
        if key not in self.scored:
            self.scored[key] = self._scores(state, tangents)
        return self.scored[key]

    def _scores(self, state: State, tangents: Tangents) -> list[Score]:
        taken = {c.key for c in state.effects}
        # So far off with effects in it, a set wants more than any few channels.
        hopeless = bool(state.effects) and not self.untouched and self._misfit(state) > GROSS
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
        self._draw_null(tangents)
        return sorted((s for s in found if s is not None), key=lambda s: -s.log_evidence)

    def _draw_null(self, tangents: Tangents) -> None:
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

    def _gross(self, state: State) -> State | None:
        """`state` with one gross fault of the wiring, None where none is plain to see.

        Such a fault leads the calibrations astray, and what is linear about them: each is tried
        with the beliefs as they are, one common factor free.
        """
        if self._misfit(state) < GROSS:
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
        self._draw_null(self.linearised(found))
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
        p = self._own_p(trial.score, less, trial)
        return p < SIGNIFICANT and trial.log_evidence > less.log_evidence + LEAST_EVIDENCE

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
        weights = whitening.back(tangents.residual.reshape(tangents.voltage.shape)).ravel()
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

    def _own_p(self, score: Score, state: State, trial: State) -> float:
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
        of its likelihood ratio, as of `_own_p`, best first; but for one that is `known` to have the
        log evidence `best`. The likeliest is fitted first; the others are given up where they fall
        RACE behind it, or behind `best`."""
        key = state.key
        if key not in self.trials:
            found: list[State] = []
            listed = shortlist(scores) if self._hopeful(scores) else []
            listed += self._afar(state, listed)
            competing = self._competing(state, {s.candidate.name for s in listed})

            def attempt(one: Score) -> State | None:
                if self.spent:
                    return None
                trial = self.with_effect(state, one.candidate, self._cost(state, best - RACE))
                if trial is not None:
                    own = trial.fit.problem.whitening
                    if own is not state.fit.problem.whitening:
                        own.forget()  # most trials are never looked at again
                return trial

            taken = known and known.key
            open_to = [s for s in [*listed, *competing] if s.candidate.key != taken]
            trials = [attempt(one) for one in open_to[:1]]  # what the others have to come near to
            best = max([best, *(one.log_evidence for one in trials if one is not None)])
            trials += self._fits(state, attempt, open_to[1:])
            for s, trial in zip(open_to, trials, strict=True):
                if trial is not None:
                    trial.score = s
                    new = added(state, trial)
                    trial.p_values[new.key] = self._own_p(s, state, trial)
                    found.append(trial)
                    if not trial.fit.ended:
                        self.report(f"{new.name}: its fit did not come to an end")
            found.sort(key=lambda s: -s.log_evidence)
            self.trials[key] = found
        return self.trials[key]

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

    def rough(self, state: State) -> Problem:
        """The problem with bodies solved coarsely, readings uncertain by what a state leaves
        unexplained, within COARSE and AFAR: what no skin explains must not hide one that is nearly
        right, nor be fitted at any price."""
        if state.rig is None:
            return self.problem
        left = float(np.clip(state.sizes.get(UNEXPLAINED, 0.0), COARSE, AFAR))
        whitening = state.rig.whitening({UNEXPLAINED: left})
        return replace(self.problem, model=self.problem.model.coarsely(), whitening=whitening)

    def _from_afar(
        self,
        state: State,
        candidates: list[Candidate],
        sizes: Sequence[tuple[float, ...]] | None = None,
    ) -> State | None:
        """`state` with candidates fitted from the beliefs, whatever the state before has made of
        them; sizes: as of `afar.start`."""
        effects = [*state.effects, *candidates]
        problem, left = self.rough(state), {UNEXPLAINED: state.sizes.get(UNEXPLAINED, 0.0)}
        try:
            with self.problem.model.near.within(self.most_solved):
                _, start = afar.start(problem, state.effects, state.fit.theta, candidates, sizes)
                theta = fit(problem, effects, start, polish=True).theta
                rough = fit(replace(problem, model=self.problem.model), effects, theta)
                found = self.state(rough, state.p_values, left)
                known = found.fit.theta, found.fit.jacobian
                fitted = fit(found.fit.problem, effects, *known)
                return self.state(fitted, state.p_values, found.sizes, found.rig)
        except (InputError, np.linalg.LinAlgError, Spent):
            return None

    def with_effect(
        self, state: State, candidate: Candidate, enough: float = np.inf
    ) -> State | None:
        """`state` with a candidate fitted beside what is there; joined to a sparse effect of the
        same name. None where it cannot be, goes astray or would take too long; enough: as of
        `fit`."""
        effects, theta, jacobian = list(state.effects), state.fit.theta, state.fit.jacobian
        for index, other in enumerate(effects):
            if other.name != candidate.name or other.kind != candidate.kind:
                continue
            both = {other.scope, candidate.scope}
            if (
                both == {"sparse"}
                and other.start == candidate.start
                and candidate.effect.parameters
                and not candidate.effect.site_number
            ):
                joined = _joined(other, candidate)
                if joined is None:
                    return None
                place = state.fit.place(index)
                values = np.zeros(joined.size)
                for i, name in enumerate(joined.names):
                    if name[1] is None:
                        values[i] = theta[place][other.names.index(name)]
                    elif (site := joined.own_sites[name[1]]) in other.own_sites:
                        old = (name[0], other.own_sites.index(site))
                        values[i] = theta[place][other.names.index(old)]
                start = np.r_[theta[: place.start], values, theta[place.stop :]]
                effects[index] = joined
                return self._fitted(effects, start, None, state, enough)
            if not other.effect.several or _one_entry(other, candidate):
                return None
        if self.starts_afar(candidate):
            return self._from_afar(state, [candidate])
        start = np.r_[theta, np.zeros(candidate.size)]
        columns = self.linearised(state).jacobian(candidate)
        known = np.concatenate([jacobian, columns])
        return self._fitted([*effects, candidate], start, known, state, enough)

    def _fitted(
        self,
        effects: list[Candidate],
        start: np.ndarray,
        jacobian: np.ndarray | None,
        state: State,
        enough: float,
    ) -> State | None:
        try:
            with self.problem.model.near.within(self.most_solved):
                problem = state.fit.problem
                fitted = fit(problem, effects, start, jacobian, enough=enough)
                far = jacobian is not None and self._misfit(state) > GROSS
                # Calibrations that took what an effect is may lie far off along a narrow valley.
                if discrete(effects[-1]) or far or not fitted.ended:
                    knobs = len(self.problem.model.calibrations)
                    afresh = np.r_[np.zeros(knobs), start[knobs:]]
                    again = fit(problem, effects, afresh, enough=enough)
                    fitted = min(fitted, again, key=lambda f: f.chi2)
                if fitted.cost > state.fit.cost + 2.0 * LOST:
                    return None
                return self.state(fitted, state.p_values, state.sizes, state.rig)
        except (InputError, np.linalg.LinAlgError, Spent):
            return None

    def without(self, state: State, index: int) -> State:
        """`state` less one effect, the rest fitted anew, from the beliefs where no skin has the
        rest alone."""
        place = state.fit.place(index)
        effects = [c for i, c in enumerate(state.effects) if i != index]
        theta = np.delete(state.fit.theta, np.arange(place.start, place.stop))
        jacobian = np.delete(state.fit.jacobian, np.arange(place.start, place.stop), axis=0)
        try:
            fitted = fit(state.fit.problem, effects, theta, jacobian)
        except InputError:
            fitted = fit(state.fit.problem, effects, np.zeros_like(theta))
        return self.state(fitted, state.p_values, state.sizes, state.rig)

    def _each_without(self, state: State, count: int) -> list[tuple[int, State]]:
        """`without` of each of the first `count` effects, with its number."""
        return list(enumerate(self._fits(state, lambda i: self.without(state, i), range(count))))

    def renew_catalogue_p(self, state: State) -> None:
        """`catalogue_p` of a state, where it is another's."""
        if state.key != self.catalogue_of and not (self.spent or self.unlike(state)):
            scores = self.scores(state)
            self.catalogue_p = self.global_p(min((s.p_value for s in scores), default=1.0))
            self.catalogue_of = state.key

    def _confirmed(self, state: State) -> State:
        """A state that was found on fewer frames, less the effects that all of them do not bear
        out, each with the p-value of its likelihood ratio on all of them."""
        self._draw_null(self.linearised(state))
        while True:
            for index, less in self._each_without(state, len(state.effects)):
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
            for index, less in self._each_without(state, len(state.effects) - 1):
                if less.log_evidence > state.log_evidence - LEAST_EVIDENCE:
                    self.step("drop", state.effects[index], less)
                    state, dropped = less, True
                    break
        state = self._trim(state)
        return self.state(self._polished(state.fit), state.p_values, state.sizes, state.rig)

    def _polished(self, found: Fit) -> Fit:
        """A fit at its optimum, with a fresh Jacobian; near it, where no more may be solved."""
        renewals = RENEWALS if self.spent else MOST_ROUNDS
        start = found.theta, found.jacobian
        return fit(found.problem, found.effects, *start, polish=True, renewals=renewals)

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

    def less(self, state: State, index: int) -> State:
        """`state` less one effect, polished unless no more may be solved; kept, with its tangents
        where the set was met."""
        key = tuple(c.key for i, c in enumerate(state.effects) if i != index)
        if key in self.met:
            return replace(self.met[key], p_values=dict(state.p_values))
        whole, less = self.lesser.get(key, (None, None))
        if less is None or whole is not state.fit:
            less = self.without(state, index)
            if not self.spent:
                less = self.state(self._polished(less.fit), less.p_values, less.sizes, less.rig)
            self.lesser[key] = state.fit, less
        return replace(less, p_values=dict(state.p_values))

    def _cost(self, state: State, log_evidence: float) -> float:
        """What a fit may cost at most in the covariance of `state`, for a log evidence."""
        return -2.0 * (log_evidence - state.log_likelihood) + state.fit.chi2

    def _misfit(self, state: State) -> float:
        """Chi squared over its degrees of freedom against noise alone."""
        whitening = self.problem.whitening
        left = whitening(state.fit.problem.whitening.undone(state.fit.residual))
        return float((left**2).sum()) / max(whitening.size - len(state.fit.theta), 1)

    def held_out(self, state: State, trial: State) -> HeldOut:
        """What a state predicts for frames left out, in the covariance of a trial."""
        return held_out(whitened_anew(state.fit, trial.fit.problem), self.fold)

    def likeness(self, state: State) -> float:
        """Squared correlation of the readings, in noise units, with what is simulated; below 0
        where it is negative."""
        whitening = self.problem.whitening
        there = whitening.mask
        simulated, recorded = (
            (voltage / whitening.sd)[there]
            for voltage in (state.fit.voltage(), self.problem.recorded)
        )
        simulated, recorded = simulated - simulated.mean(), recorded - recorded.mean()
        lengths = float((simulated @ simulated) * (recorded @ recorded))
        along = float(simulated @ recorded)
        return along * abs(along) / max(lengths, 1e-300)

    def unlike(self, state: State) -> bool:
        """Whether readings are not those of a skin like this: in an order of their own, or none.
        Effects fitted to them are no findings, were they ever so significant."""
        return self._misfit(state) > GROSS and self.likeness(state) < ALIKE

    def gain(self, trial: State, state: State) -> tuple[float, float]:
        """Log density of held-out frames above another state's, and its standard error, both in
        the trial's covariance."""
        return trial.held_out.gain(self.held_out(state, trial))

    def predicts(self, trial: State, state: State) -> bool:
        """Whether a trial predicts held-out frames better than another state by more than two
        standard errors."""
        gain, error = self.gain(trial, state)
        return gain > STANDARD_ERRORS * error

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


def _one_entry(a: Candidate, b: Candidate) -> bool:
    """Whether two candidates of a name would be one entry: their starts differ in nothing that both
    have."""
    return all(b.start[key] == value for key, value in a.start.items() if key in b.start)


def _joined(a: Candidate, b: Candidate) -> Candidate | None:
    sites = tuple(sorted({*a.own_sites, *b.own_sites}))
    if len(sites) == len(a.own_sites) or len(sites) > MOST_JOINED:
        return None
    return Candidate(
        a.effect, a.kind, sites, "sparse", a.start, a.skin, a.scales, a.looks * b.looks
    )
