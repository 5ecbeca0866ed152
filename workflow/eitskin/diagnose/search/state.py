"""A set of effects fitted: what it predicts, and the evidence for it."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.fitting.held_out import HeldOut, held_out
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.search.screen import AMPLITUDES, Score
from eitskin.effects import EFFECTS


@dataclass
class State:
    """A set of effects fitted, with the rig's errors beside it and their sizes, and what it
    predicts for frames left out. log_likelihood: marginal, in nats, the same constant for all sets;
    score: of the effect that came last, where it is a trial."""

    fit: Fit
    fold: np.ndarray
    log_likelihood: float
    log_evidence: float
    p_values: dict[tuple, float] = field(default_factory=dict)
    sizes: dict[str, float] = field(default_factory=dict)
    rig: RigErrors | None = field(default=None, repr=False)
    score: Score | None = None

    @cached_property
    def held_out(self) -> HeldOut:
        """What it predicts for frames left out."""
        return held_out(self.fit, self.fold)

    def p_value(self, candidate: Candidate) -> float:
        """Global p-value with which an effect, or the first of its sites, came in."""
        own = [p for key, p in self.p_values.items() if key[:2] == candidate.key[:2]]
        return self.p_values.get(candidate.key, min(own, default=1.0))

    @property
    def effects(self) -> list[Candidate]:
        """The effects, in the order in which they came in."""
        return self.fit.effects

    @property
    def key(self) -> tuple:
        """What its set of effects is known by."""
        return tuple(c.key for c in self.effects)


def added(state: State, trial: State) -> Candidate:
    """What a trial has that the state it came from has not."""
    (new,) = (c for c in trial.effects if c.key not in {own.key for own in state.effects})
    return new


def per_dof(state: State) -> float:
    return state.fit.chi2 / max(state.fit.problem.whitening.size - len(state.fit.theta), 1)


def likelihood(fitted: Fit, sizes: dict[str, float], rig: RigErrors | None) -> float:
    """Marginal log likelihood of a fit, with the prior of the sizes of the rig's errors."""
    prior = 0.0 if rig is None else rig.log_prior(sizes)
    return prior - 0.5 * (fitted.chi2 + fitted.problem.whitening.log_determinant)


def occam(fitted: Fit) -> float:
    """What Laplace's log evidence of a set has beyond its log likelihood: Occam factors, prior over
    names and sites. Each effect's coordinates have a normal prior about 0 with the best sd of
    AMPLITUDES.
    """
    covariance = fitted.covariance
    total = 0.0
    for index, effect in enumerate(fitted.effects):
        place = fitted.place(index)
        total -= math.log(effect.looks) + math.log(len(EFFECTS))
        if effect.size:
            information = np.linalg.inv(covariance[place, place])
            value = fitted.theta[place]
            total += max(_one_occam(value, information, a) for a in AMPLITUDES)
            total -= np.log(len(AMPLITUDES))
    return float(total)


def _one_occam(value: np.ndarray, information: np.ndarray, amplitude: float) -> float:
    spread = np.eye(len(value)) + amplitude**2 * information
    return float(-0.5 * (value @ value) / amplitude**2 - 0.5 * np.linalg.slogdet(spread)[1])
