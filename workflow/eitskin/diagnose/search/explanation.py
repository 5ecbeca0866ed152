"""A set of effects fitted: what it predicts, and the evidence for it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.fitting.held_out import CrossValidation, held_out
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.search.screen import AMPLITUDES, Score
from eitskin.effects import EFFECTS


@dataclass(frozen=True)
class Explanation:
    """A set of effects fitted, with the errors of the rig beside it.

    folds: (N,) of frames, or (1, M) of channels; log_likelihood: marginal, in nats, up to a
    constant that all sets of a recording share; log_evidence: with the Occam factors; p_values:
    global, by the candidates' keys; error_sds: of the rig's errors, by name; rig: these errors
    linearised; score: of the effect that came last, where this is a trial.
    """

    fit: Fit
    folds: np.ndarray
    log_likelihood: float
    log_evidence: float
    p_values: Mapping[tuple, float] = field(default_factory=dict)
    error_sds: Mapping[str, float] = field(default_factory=dict)
    rig: RigErrors | None = field(default=None, repr=False)
    score: Score | None = None

    @cached_property
    def held_out(self) -> CrossValidation:
        """What it predicts for the folds left out, each from the others."""
        return held_out(self.fit, self.folds)

    def p_value(self, candidate: Candidate) -> float:
        """Global p-value with which an effect, or the first of its sites, came in."""
        of_name = [p for key, p in self.p_values.items() if key[:2] == candidate.key[:2]]
        return self.p_values.get(candidate.key, min(of_name, default=1.0))

    @property
    def effects(self) -> list[Candidate]:
        """The effects, in the order in which they came in."""
        return self.fit.effects

    @property
    def key(self) -> tuple:
        """What tells its set of effects from other sets."""
        return tuple(c.key for c in self.effects)

    @property
    def chi2_per_dof(self) -> float:
        """Chi squared over its degrees of freedom, in the covariance of the fit."""
        return self.fit.chi2 / max(self.fit.problem.whitening.size - len(self.fit.theta), 1)

    def with_p_values(
        self, p_values: Mapping[tuple, float], score: Score | None = None
    ) -> "Explanation":
        """The same with other p-values, and with a score where one is given; what was predicted is
        not computed again."""
        copy = replace(self, p_values=dict(p_values), score=score or self.score)
        if "held_out" in vars(self):
            vars(copy)["held_out"] = self.held_out
        return copy


def added_effect(explanation: Explanation, trial: Explanation) -> Candidate:
    """The effect that a trial has and the explanation that it came from has not."""
    keys = {candidate.key for candidate in explanation.effects}
    (new,) = (c for c in trial.effects if c.key not in keys)
    return new


def marginal_likelihood(fit: Fit, error_sds: Mapping[str, float], rig: RigErrors | None) -> float:
    """Log marginal likelihood of a fit, -(chi2 + log det C) / 2 with the covariance C over that of
    white noise, and the log prior of the sds of the rig's errors and of the members of families."""
    prior = 0.0 if rig is None else rig.log_prior(error_sds)
    members, _ = fit.problem.model.member_columns
    prior -= 0.5 * float((fit.theta[members] ** 2).sum())
    return prior - 0.5 * (fit.chi2 + fit.problem.whitening.log_determinant)


def occam_factor(fit: Fit) -> float:
    """Log Occam factor of a fit: what Laplace's log evidence has beyond the log likelihood.

    Each effect's coordinates have a normal prior about 0 with the best sd of AMPLITUDES; names and
    sites have a uniform prior (MacKay, Neural Computation 4, 1992).
    """
    covariance = fit.covariance
    total = 0.0
    for index, effect in enumerate(fit.effects):
        place = fit.coordinate_slice(index)
        total -= math.log(effect.looks) + math.log(len(EFFECTS))
        if effect.size:
            information = np.linalg.inv(covariance[place, place])
            coordinates = fit.theta[place]
            total += max(_occam_factor(coordinates, information, a) for a in AMPLITUDES)
            total -= np.log(len(AMPLITUDES))
    return float(total)


def _occam_factor(coordinates: np.ndarray, information: np.ndarray, amplitude: float) -> float:
    """Of coordinates (k,) with information (k, k) and the prior sd `amplitude`."""
    spread = np.eye(len(coordinates)) + amplitude**2 * information
    square = coordinates @ coordinates
    return float(-0.5 * square / amplitude**2 - 0.5 * np.linalg.slogdet(spread)[1])
