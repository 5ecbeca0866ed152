"""Sets of effects fitted to a recording, weighed by their evidence and by held-out frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.candidates import Candidate, discrete
from eitskin.diagnose.fitting.fit import (
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
from eitskin.diagnose.fitting.held_out import HeldOut, held_out
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.rig import COMPONENTS, Rig
from eitskin.diagnose.noise.rig_sizes import SETTLED, KeptScoring, learned
from eitskin.diagnose.search import afar
from eitskin.diagnose.search.state import State, likelihood, occam
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.physics.solver import EffortExceeded

Part = TypeVar("Part")
Result = TypeVar("Result")

STANDARD_ERRORS = 2.0
LEARNED = 4  # times at most that sizes of rig errors and a fit follow each other
MOST_SOLVED = 16_000  # sheets, of one diagnosis
UNEXPLAINED = "static-discrepancy"  # the component of a value a channel
ALIKE = 0.3  # squared correlation with the simulation, from which on names are looked for
MOST_JOINED = 8  # sites of an effect that is still called sparse
# Of the readings: what a fit from afar may leave at most, to begin with, and at least, for bodies
# are solved coarsely there.
AFAR, COARSE = 0.05, 3e-4
GROSS = 30.0  # chi squared over its degrees of freedom above which gross faults are tried first
# A fit without its discrepancy that is so many nats behind after one step, with what the next one
# promises, is given up, unless chi squared says that it is far off (GROSS).
FORLORN = 150.0
LOST = 100.0  # nats behind the state that it began from: a fit that went astray
TOGETHER = 4  # fits in processes of their own, of which none knows what the others solve


@dataclass
class Fitting:
    """One recording's sets of effects, fitted. problem: with noise alone in its covariance; fold:
    of frames, or of channels too where nobody touches; rigged: whether a rig may add to the
    covariance, converter_step: as `step` of `Noise`; rig: what it may add; share: of all that a
    diagnosis may solve, with which this ends."""

    problem: Problem
    candidates: list[Candidate]
    fold: np.ndarray
    share: float = 1.0
    rigged: bool = False
    converter_step: float = 0.0
    rig: Rig | None = None
    tangents: dict[tuple, Tangents] = field(default_factory=dict)
    met: dict[tuple, State] = field(default_factory=dict)
    lesser: dict[tuple, tuple[Fit, State]] = field(default_factory=dict)
    scoring: KeptScoring = field(default_factory=KeptScoring, repr=False)

    @property
    def most_solved(self) -> float:
        """Sheets after which nothing more is tried for its own sake."""
        return self.share * MOST_SOLVED

    @property
    def untouched(self) -> bool:
        """Whether nobody touches: folds are of channels then."""
        return self.fold.ndim == 2

    @property
    def spent(self) -> bool:
        """Whether the search has taken so long that it ends with what it has."""
        return self.problem.model.near.effort > self.most_solved

    def starts_afar(self, candidate: Candidate) -> bool:
        """Whether no tangent leads to a candidate, so that its fits begin as of `afar`."""
        return self.untouched and afar.is_far(candidate)

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
        if moved is not named and behind > FORLORN and self.misfit(found) < GROSS:
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

    def fits(
        self, state: State, of: Callable[[Part], Result], parts: Sequence[Part]
    ) -> list[Result]:
        """A function of every part, which fits something about a state, as of `apart`. Each may
        solve all that may still be solved, TOGETHER of them; then what they solved counts."""
        if len(parts) < 2:
            return [of(part) for part in parts]
        if state.rig is not None and not self._bodies:
            self.scoring.prepare(state.rig, state.sizes)
        shared = [*state.effects, state.rig, *self._parts_of(state.fit.problem)]
        found: list[Result] = []
        for start in range(0, len(parts), TOGETHER):
            found += self.apart(of, parts[start : start + TOGETHER], shared)
        return found

    def apart(
        self, of: Callable[[Part], Result], parts: Sequence[Part], shared: Sequence[object] = ()
    ) -> list[Result]:
        """A function of every part, each in a process of its own: what it changes in this search
        but its result is lost, which may refer to what is shared. One after the other in this
        process where bodies are tried, of which two at once take too much memory."""
        if self._bodies:
            return [of(part) for part in parts]
        own = [*EFFECTS.values(), self.fold, self.rig, *self._parts_of(self.problem)]
        return self.problem.model.near.forked(of, parts, [*own, *shared])

    @property
    def _bodies(self) -> bool:
        return any(candidate.effect.body for candidate in self.candidates)

    @staticmethod
    def _parts_of(problem: Problem) -> list[object]:
        own = problem.whitening
        arrays = own.mask, own.sd, own.rho, own.clock
        return [problem, *vars(problem).values(), *vars(problem.model).values(), *arrays]

    def calibrated(self) -> State:
        """The owner's beliefs with their calibrations fitted, no effect."""
        start = np.zeros(len(self.problem.model.calibrations))
        best = fit(self.problem, [], start, polish=True)
        if self.rigged and self.rig is None:
            self.rig = Rig.about(best, self.problem.whitening, self.converter_step)
        near = self.state(best)
        far = self.from_afar(near, []) if self.rigged and self.untouched else None
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

    def linearised(self, state: State) -> Tangents:
        """Tangents about a state, kept until its set is fitted anew; their whitened columns until
        those of another set are asked for."""
        key = state.key
        if key not in self.met or self.met[key].fit is not state.fit:
            strayed = state.fit.problem.model is not self.problem.model
            fitted = refreshed(state.fit) if strayed else state.fit
            self.tangents[key] = Tangents(fitted, reversed(self.tangents.values()))
            self.met[key] = state
        found = self.tangents[key]
        for other in self.tangents.values():
            if other is not found:
                other.forget()
        return found

    def rough(self, state: State) -> Problem:
        """The problem with bodies solved coarsely, readings uncertain by what a state leaves
        unexplained, within COARSE and AFAR: what no skin explains must not hide one that is nearly
        right, nor be fitted at any price."""
        if state.rig is None:
            return self.problem
        left = float(np.clip(state.sizes.get(UNEXPLAINED, 0.0), COARSE, AFAR))
        whitening = state.rig.whitening({UNEXPLAINED: left})
        return replace(self.problem, model=self.problem.model.coarsely(), whitening=whitening)

    def from_afar(
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
        except (InputError, np.linalg.LinAlgError, EffortExceeded):
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
            return self.from_afar(state, [candidate])
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
                far = jacobian is not None and self.misfit(state) > GROSS
                # Calibrations that took what an effect is may lie far off along a narrow valley.
                if discrete(effects[-1]) or far or not fitted.ended:
                    knobs = len(self.problem.model.calibrations)
                    afresh = np.r_[np.zeros(knobs), start[knobs:]]
                    again = fit(problem, effects, afresh, enough=enough)
                    fitted = min(fitted, again, key=lambda f: f.chi2)
                if fitted.cost > state.fit.cost + 2.0 * LOST:
                    return None
                return self.state(fitted, state.p_values, state.sizes, state.rig)
        except (InputError, np.linalg.LinAlgError, EffortExceeded):
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

    def each_without(self, state: State, count: int) -> list[tuple[int, State]]:
        """`without` of each of the first `count` effects, with its number."""
        return list(enumerate(self.fits(state, lambda i: self.without(state, i), range(count))))

    def polished(self, found: Fit) -> Fit:
        """A fit at its optimum, with a fresh Jacobian; near it, where no more may be solved."""
        renewals = RENEWALS if self.spent else MOST_ROUNDS
        start = found.theta, found.jacobian
        return fit(found.problem, found.effects, *start, polish=True, renewals=renewals)

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
                less = self.state(self.polished(less.fit), less.p_values, less.sizes, less.rig)
            self.lesser[key] = state.fit, less
        return replace(less, p_values=dict(state.p_values))

    def cost(self, state: State, log_evidence: float) -> float:
        """What a fit may cost at most in the covariance of `state`, for a log evidence."""
        return -2.0 * (log_evidence - state.log_likelihood) + state.fit.chi2

    def misfit(self, state: State) -> float:
        """Chi squared over its degrees of freedom against noise alone."""
        whitening = self.problem.whitening
        left = whitening(state.fit.problem.whitening.undone(state.fit.residual))
        return float((left**2).sum()) / max(whitening.size - len(state.fit.theta), 1)

    def held_out(self, state: State, trial: State) -> HeldOut:
        """What a state predicts for frames left out, in the covariance of a trial."""
        return held_out(whitened_anew(state.fit, trial.fit.problem), self.fold)

    def gain(self, trial: State, state: State) -> tuple[float, float]:
        """Log density of held-out frames above another state's, and its standard error, both in
        the trial's covariance."""
        return trial.held_out.gain(self.held_out(state, trial))

    def predicts(self, trial: State, state: State) -> bool:
        """Whether a trial predicts held-out frames better than another state by more than two
        standard errors."""
        gain, error = self.gain(trial, state)
        return gain > STANDARD_ERRORS * error

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
        return self.misfit(state) > GROSS and self.likeness(state) < ALIKE


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
