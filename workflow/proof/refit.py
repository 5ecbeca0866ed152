"""Effects fitted to a recording whose truth is known, by the diagnosis' own parts.

With `tangent_basis` and `rig_sizes` the only modules of the proof that know the search from within.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.candidates import Candidate, is_wiring_fault
from eitskin.diagnose.fitting.estimates import estimates
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.fitting.fit import Fit, fit
from eitskin.diagnose.fitting.query import predict, simulator
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search import proposals, refits
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.journal import Refusal
from eitskin.diagnose.search.screen import NullDistribution
from eitskin.diagnose.search.search import Cache, Search
from eitskin.diagnose.search.staging import prepared
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.gaps import Gap, gaps
from eitskin.effects.effect import SITES
from eitskin.physics.solver import EffortExceeded
from witness.cases import Case

FIT_SHEETS = 4_000  # sheets that the fit of one set may solve: some minutes
GAP_SHEETS = 24_000  # sheets that the gaps of one case may solve
CERTAIN_DOF = 1e9  # degrees of freedom of a noise that is known
SHARED_TANGENTS = 3  # tangents whose derivatives later recordings may share
SMALL_P = 0.1  # p below which a recording has derivatives of its own
Gaps = list[list[tuple[str, float]] | None]


def calibrated(recorded: Recording, seed: int) -> tuple[NoiseModel, Search, Explanation]:
    """The noise, the search and its state without effects, as a diagnosis starts."""
    noise, search, _ = prepared(recorded, seed)
    return noise, *refits.calibrated(search)


@dataclass(frozen=True)
class Refit:
    """A recording, thinned as a diagnosis thins it, to which any set of effects can be fitted;
    noise: as estimated from it; nothing: the state with no effect."""

    recorded: Recording
    noise: NoiseModel
    search: Search
    nothing: Explanation

    @classmethod
    def of(cls, recorded: Recording, seed: int) -> "Refit":
        """As a diagnosis with this seed starts."""
        thinned = excerpt(recorded)
        noise, search, nothing = calibrated(thinned, seed)
        return cls(thinned, noise, replace(search, budget_share=math.inf), nothing)

    def with_effects(self, effects: list[dict], scopes: list[str]) -> Explanation | None:
        """The state with true effects; None where one of them cannot be fitted, or where all take
        more than FIT_SHEETS."""
        candidates = [
            _starting(candidate_of(self.search.candidates, effect, scope), effect)
            for effect, scope in zip(effects, scopes, strict=True)
        ]
        if not candidates:
            return self.nothing
        near = self.search.problem.model.solved_skins
        try:
            with near.within(near.effort + FIT_SHEETS):
                return with_all(self.search, self.nothing, candidates)
        except EffortExceeded:
            return None

    def as_named(self, entries: list[dict]) -> Explanation | None:
        """The state with the effects that a diagnosis named."""
        effects = [
            {"name": entry["name"]}
            | {"parameters": {key: e["value"] for key, e in entry["parameters"].items()}}
            | {kind: entry[kind] for kind in SITES if entry[kind]}
            for entry in entries
        ]
        return self.with_effects(effects, [entry["scope"] for entry in entries])

    def prediction(self, state: Explanation, query: Recording) -> np.ndarray:
        """(Q, M): a query's readings by a state, in the recording's unit."""
        return simulator(state.fit, self.recorded, query)(state.fit.theta)

    def misfit(self) -> np.ndarray:
        """(N, M): readings less those of the state without effects, in the recording's unit; NaN
        where the search does not see one."""
        misfit = self.recorded.voltage - refits.as_reported(self.search, self.nothing.fit)
        return np.where(self.search.problem.whitening.mask, misfit, np.nan)


def entries_of(state: Explanation, effects: list[dict]) -> list[dict]:
    """True effects as a diagnosis with this state would name them."""
    index_of = {candidate.name: i for i, candidate in enumerate(state.effects)}
    entries = []
    for effect in effects:
        index = index_of[effect["name"]]
        candidate = state.effects[index]
        sites: dict[str, list[int]] = {kind: [] for kind in SITES}
        if candidate.kind is not None and candidate.scope != "common":
            sites[candidate.kind] = [int(site) for site in candidate.site_indices]
        parameters = estimates(state.fit, index)
        entries.append({"name": candidate.name, "parameters": parameters, **sites})
    return entries


def _starting(candidate: Candidate, effect: dict) -> Candidate:
    """A candidate whose fit starts from the truth where it must start somewhere."""
    parameters = effect.get("parameters", {})
    true = {k: parameters[k] for k in candidate.start if parameters.get(k) is not None}
    return replace(candidate, start={**candidate.start, **true})


def missing(diagnosis: Diagnosis, case: Case) -> float:
    """`snr_left` of a case beyond what a diagnosis named, both where its touches truly were: that
    a rig has them elsewhere is no physics left out."""
    query = Recording(case.true_states, None, None, None, dict(case.metadata))
    simulated, _ = predict(diagnosis.explanation.fit, diagnosis.recording, query)
    return snr_left(diagnosis.explanation.fit, simulated, case.clean)


def snr_left(fitted: Fit, simulated: np.ndarray, clean: np.ndarray) -> float:
    """Length, in noise units, of what noise-free readings (N, M) V have beyond those that a fit
    has for them, (N, M) V, all that was fitted projected out."""
    residual = fitted.problem.whitening(clean - simulated).ravel()
    slopes = fitted.jacobian.reshape(len(fitted.theta), -1).T
    return float(np.linalg.norm(residual - slopes @ np.linalg.lstsq(slopes, residual)[0]))


def true_gaps(diagnosis: Diagnosis, truth: list[dict], scopes: list[str]) -> Gaps:
    """Gaps of each true effect to the other names, the nearest first, with the true set fitted;
    None where it cannot be fitted. Nothing of the diagnosis depends on it, nor does it end where
    that was cut short; but gaps are those of the linearised model then."""
    states = diagnosis.baseline, diagnosis.explanation
    return _gaps_of_set(diagnosis.search, states, diagnosis.gaps, truth, scopes)


def gaps_in_noise(case: Case, noise_V: np.ndarray) -> Gaps | None:
    """Gaps of a case's effects in noise (M,) V, as `true_gaps`, on its noise-free recording; None
    of one without effects, or where they take more than GAP_SHEETS."""
    if not case.effects:
        return None
    clean = Recording(case.true_states, case.clean, None, None, dict(case.metadata))
    _, search, _ = prepared(clean, 1)
    problem, _ = problem_of(clean, NoiseModel(noise_V, CERTAIN_DOF, "known"))
    search = replace(search, problem=problem)
    try:
        with problem.model.solved_skins.within(GAP_SHEETS):
            search, nothing = refits.calibrated(search)
            return _gaps_of_set(search, (nothing, nothing), [], case.effects, case.scopes)
    except EffortExceeded:
        return None


def _gaps_of_set(
    search: Search,
    states: tuple[Explanation, Explanation],
    state_gaps: list[list[Gap]],
    truth: list[dict],
    scopes: list[str],
) -> Gaps:
    """As `true_gaps`; states: without effects and after the search, with the gaps of the latter's
    effects."""
    nothing, state = states
    candidates = [
        candidate_of(search.candidates, *pair) for pair in zip(truth, scopes, strict=True)
    ]
    if not candidates:
        return []
    if {(c.name, c.sites) for c in candidates} != {(c.name, c.sites) for c in state.effects}:
        fitted = with_all(replace(search, budget_share=math.inf), nothing, candidates)
        if fitted is None:
            return [None] * len(candidates)
        state = fitted
        state_gaps = [gaps(search, state, i) for i in range(len(candidates))]
    gaps_of = {c.name: pairs for c, pairs in zip(state.effects, state_gaps, strict=True)}
    return [[(gap.rival, gap.gap) for gap in gaps_of[effect["name"]]] for effect in truth]


def with_all(search: Search, state: Explanation, candidates: list[Candidate]) -> Explanation | None:
    """`state` with candidates fitted one after the other, the gross faults first; None where one
    cannot be."""
    for candidate in sorted(candidates, key=lambda c: not is_wiring_fault(c)):
        fitted = refits.with_effect(search, state, candidate)
        if isinstance(fitted, Refusal):
            return None
        state = fitted
    fitted_set = fit(search.problem, state.effects, state.fit.theta, polish=True)
    return refits.explain(search, fitted_set)


def candidate_of(candidates: list[Candidate], effect: dict, scope: str) -> Candidate:
    """The candidate that a true effect is, starting near its values."""
    kind = next((kind for kind in SITES if kind in effect), None)
    named = [c for c in candidates if c.name == effect["name"]]
    if kind is not None:
        like = next(c for c in named if c.kind == kind)
        return replace(like, sites=tuple(effect[kind]), scope="sparse")
    named = [c for c in named if c.scope in (scope, "")] or named
    parameters = effect.get("parameters", {})

    def distance(candidate: Candidate) -> float:
        return sum(abs(parameters.get(k, 0.0) - v) for k, v in candidate.start.items())

    nearest = min(named, key=distance)
    neutral, skin = nearest.effect.neutral, nearest.skin
    free = {k: v for k, v in parameters.items() if v is not None and neutral(k, skin) is None}
    return replace(nearest, start={**free, **nearest.start})


class ScoreTests:
    """Score tests of recordings of one skin. Their derivatives are shared where readings are near
    enough and p is not small, which changes it by about 1 %; what chance gives is drawn once for
    every rig, which changes p as much as any other draw does."""

    def __init__(self, seed: int):
        self.seed = seed
        self.tangents: dict[tuple, Tangents] = {}
        self.nulls: dict[str, NullDistribution] = {}

    def best(self, recorded: Recording, rig: str) -> dict:
        """{p_value, p_local, name, learned} of the best of all candidates about the calibration of
        a recording, which is as far as a diagnosis goes before it fits an effect."""
        _, search, _ = prepared(recorded, self.seed)
        search.cache.tangents.update(self.tangents)
        search.cache.null = self.nulls.get(rig)
        search, state = refits.calibrated(search)
        best = min(proposals.scores(search, state), key=lambda score: score.p_value)
        tangents = refits.linearised(search, state)
        is_small = proposals.global_p(search, best.p_value) < SMALL_P
        if tangents.source is not tangents and is_small:
            # Where touches are far from where they are said to be, derivatives differ as well.
            unshared = replace(search, cache=Cache(null=search.cache.null))
            best = min(proposals.scores(unshared, state), key=lambda score: score.p_value)
        elif tangents.source is tangents and len(self.tangents) < SHARED_TANGENTS:
            self.tangents["shared", len(self.tangents)] = tangents
        assert search.cache.null is not None  # scores draw it
        self.nulls[rig] = search.cache.null
        return {
            "p_value": proposals.global_p(search, best.p_value),
            "p_local": best.p_value,
            "name": best.candidate.name,
            "learned": {name: size for name, size in state.error_sds.items() if size > 0.0},
        }
