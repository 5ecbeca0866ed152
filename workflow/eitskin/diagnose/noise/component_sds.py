"""Standard deviations of a rig's errors, learned from the residual of a fit, and their intervals.

They are those of the greatest restricted likelihood (Patterson, Thompson, Biometrika 58, 1971)
under half-normal priors, by Fisher scoring of the variances (Harville, JASA 72, 1977); a component
that the recording does not ask for has 0. What all presses share of touches' errors is projected
out: it may be the error of an effect. They are learned again for every set of effects.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.noise_model import NORMAL_90, NoiseModel
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.noise.scoring import Scoring, ScoringCache
from eitskin.diagnose.noise.whitening import Whitening

ROUNDS = 8  # of scoring at most: it converges in three or four
REFIT_ROUNDS = 2  # where a component was taken out: the others are near their optimum
SHORTENING, LEAST_SHARE = 0.3, 0.05  # of a step that does not help; shares below are not tried
LARGEST_LOG_SD = 2.0  # of a variance: by then an interval spans a factor of 50 and says nothing
# Nats that occasional components must be worth together, by the quadratic of their scoring beside
# the others: many at once hinder each other's scoring.
OCCASIONAL_GAIN = 2.0
LEAST_GAIN = 0.5  # nats that a component must be worth: half a chi squared of one, its mean
# A component is not tried without where it is worth so many nats, by the quadratic of its scoring,
# or has the sd at which learning began, within a factor.
CLEAR_GAIN, SAME_FACTOR = 4.0, 1.25
LEAST_EIGENVALUE = 1e-9  # of an information at a diagonal of ones: below it is rounding
SETTLED = 0.05  # nats, by which another round may still raise the likelihood: unseen in evidence


def learn_error_sds(
    rig_errors: RigErrors,
    residual: np.ndarray,
    start_sds: Mapping[str, float],
    start_cache: ScoringCache | None = None,
    end_cache: ScoringCache | None = None,
) -> tuple[dict[str, float], float]:
    """The sds of the greatest likelihood of a residual (N, M), from a start, and that likelihood.

    A component that is worth less than LEAST_GAIN has 0; those that are assumed have the prior's
    sd. Occasional ones enter where the others leave OCCASIONAL_GAIN. start_cache: of the scoring at
    the start; end_cache: for the scoring at the sds that are returned, unless a component is taken
    out there.
    """
    error_sds, free = rig_errors.initial_sds(start_sds), rig_errors.learned_first(start_sds)
    climb = _Climb(rig_errors, residual)
    rounds = ROUNDS if free else 0
    climbed, best, gains = climb.run(error_sds, free, rounds, start_cache, end_cache)
    if entering := climb.entering(climbed, [n for n in rig_errors.learned if n not in free]):
        free = [*free, *entering]
        climbed, best, gains = climb.run(climbed, free, ROUNDS, None, end_cache)
    error_sds = climbed
    for name in sorted(free, key=lambda k: climbed[k] / rig_errors.prior_sds[k]):
        error_sd = error_sds[name]
        unchanged = error_sd < SAME_FACTOR * start_sds.get(name, 0.0) < SAME_FACTOR**2 * error_sd
        if error_sd > 0.0 and gains.get(name, 0.0) < CLEAR_GAIN and not unchanged:
            reduced = {**error_sds, name: 0.0}
            present = [k for k in free if reduced[k] > 0.0]
            whitening = rig_errors.whitening(
                reduced, restricted=True
            )  # in use until a climb from it has met it
            likelihood = rig_errors.log_likelihood(reduced, residual, whitening)
            if likelihood <= best - LEAST_GAIN and present:
                reduced, likelihood, _ = climb.run(reduced, present, REFIT_ROUNDS)
            del whitening
            if likelihood > best - LEAST_GAIN:
                error_sds, best = reduced, likelihood
    present = [name for name in free if error_sds[name] > 0.0]
    if error_sds is not climbed and present:
        error_sds, best, _ = climb.run(error_sds, present, REFIT_ROUNDS)
    return error_sds, best


def component_intervals(
    rig_errors: RigErrors,
    error_sds: Mapping[str, float],
    unit: str,
    noise: NoiseModel | None = None,
) -> list[dict]:
    """The errors that a rig has, as in diagnosis.json: name, unit, sd, its 90 % interval (low,
    high), and whether it was learned; discrepancies are none of them.

    unit: of the readings. noise: whose correlation from frame to frame is the first of the errors.
    Intervals are of the logarithm of the variance, by the expected information.
    """
    intervals = []
    if noise is not None and noise.spectrum:
        rho = noise.spectrum.lag_one
        half = NORMAL_90 * noise.correlation_sd(rho)
        low, high = max(rho - half, -1.0), min(rho + half, 1.0)
        intervals.append(_interval("correlated-noise", "1", (rho, low, high)))
    names = [name for name in rig_errors.columns if error_sds.get(name, 0.0) > 0.0]
    if not names:
        return intervals
    variances = np.array([error_sds[name] ** 2 for name in names])
    information = Scoring(
        rig_errors, rig_errors.whitening(error_sds, restricted=True), names
    ).information
    log_variances = np.diag(np.linalg.pinv(information * np.outer(variances, variances)))
    for name, log_variance in zip(names, log_variances, strict=True):
        component, error_sd = COMPONENTS[name], error_sds[name]
        if component.discrepancy:
            continue
        assumed = name in rig_errors.assumed
        log_sd = 0.0 if assumed else min(np.sqrt(max(log_variance, 0.0)), LARGEST_LOG_SD)
        factor = np.exp(NORMAL_90 * 0.5 * log_sd)
        bounds = error_sd, error_sd / factor, error_sd * factor
        component_unit = unit if component.in_readings else component.unit
        values = tuple(component.reported_sd(bound) for bound in bounds)
        intervals.append(_interval(name, component_unit, values, not assumed))
    return intervals


def greatest_sds(
    rig_errors: RigErrors, error_sds: Mapping[str, float], names: list[str]
) -> dict[str, float]:
    """By name of some components whose estimate is 0, the end of the 90 % interval of the sd, in
    its unit: of the variance, as if normal about 0, by the expected information; 0 where fits do
    not reckon with it."""
    largest_sds = dict.fromkeys(names, 0.0)
    if fitted_names := [name for name in names if COMPONENTS[name].in_covariance]:
        whitening = rig_errors.whitening(error_sds, restricted=True)
        information = np.diag(Scoring(rig_errors, whitening, fitted_names).information)
        largest_sds |= zip(
            fitted_names, np.sqrt(NORMAL_90 / np.sqrt(information)).tolist(), strict=True
        )
    return largest_sds


def _interval(name: str, unit: str, values: tuple[float, ...], learned: bool = True) -> dict:
    """An entry of diagnosis.json; values: sd, low, high."""
    numbers = dict(zip(("sd", "low", "high"), map(float, values), strict=True))
    return {"name": name, "unit": unit, **numbers, "learned": learned}


@dataclass(frozen=True)
class _Step:
    """Where scoring leads from some sds: the target's sds; how many nats each component above 0 is
    worth there, to second order in its variance, at least, for the likelihood falls more steeply
    towards 0; and by how many the target is likelier, to second order."""

    target: dict[str, float]
    gains: dict[str, float]
    promise: float


@dataclass(frozen=True)
class _Climb:
    """Fisher scoring of the sds of a rig's errors for one residual (N, M)."""

    rig_errors: RigErrors
    residual: np.ndarray

    def run(
        self,
        error_sds: dict[str, float],
        free: list[str],
        rounds: int,
        start_cache: ScoringCache | None = None,
        end_cache: ScoringCache | None = None,
    ) -> tuple[dict[str, float], float, dict[str, float]]:
        """Sds after some rounds in those that are free, their likelihood, and the gains of the
        last step; caches: as in `learn_error_sds`."""
        rig_errors = self.rig_errors
        scoring = None
        if start_cache is not None and rounds:
            scoring = start_cache.scoring(rig_errors, error_sds, free)
        if end_cache is not None:
            end_cache.clear()
        whitening = (
            rig_errors.whitening(error_sds, restricted=True)
            if scoring is None
            else scoring.whitening
        )
        best = rig_errors.log_likelihood(error_sds, self.residual, whitening)
        gains: dict[str, float] = {}
        for _ in range(rounds):
            if scoring is None:
                scoring = Scoring(rig_errors, whitening, free)
            step = self._step(error_sds, scoring, free)
            gains = step.gains
            if step.promise < SETTLED:
                if end_cache is not None:
                    end_cache.store(rig_errors, error_sds, free, scoring)
                break
            scoring = None  # the next one takes as much memory
            improved = self._improved(error_sds, step, best)
            if improved is None:
                break
            previous = best
            error_sds, whitening, best = improved
            if best - previous < SETTLED:
                break
        return error_sds, best, gains

    def entering(self, error_sds: dict[str, float], occasional: list[str]) -> list[str]:
        """Those of some components without an sd that are worth one beside the others."""
        if not occasional:
            return []
        names = [n for n in self.rig_errors.learned if error_sds[n] > 0.0 or n in occasional]
        whitening = self.rig_errors.whitening(error_sds, restricted=True)
        step = self._step(error_sds, Scoring(self.rig_errors, whitening, names), names)
        if step.promise < OCCASIONAL_GAIN:
            return []
        return [name for name in occasional if step.target[name] > 0.0]

    def _improved(
        self, error_sds: dict[str, float], step: _Step, best: float
    ) -> tuple[dict[str, float], Whitening, float] | None:
        """Sds as far on the way to a step's target as the likelihood rises above `best`, their
        whitening and their likelihood; None where it rises nowhere."""
        share = 1.0
        while share > LEAST_SHARE and share * (2.0 - share) * step.promise > SETTLED:
            trial_sds = {
                name: float(np.sqrt((1.0 - share) * error_sds[name] ** 2 + share * target**2))
                for name, target in step.target.items()
            }
            trial_sds = {**error_sds, **trial_sds}
            whitening = self.rig_errors.whitening(trial_sds, restricted=True)
            likelihood = self.rig_errors.log_likelihood(trial_sds, self.residual, whitening)
            if likelihood > best:
                return trial_sds, whitening, likelihood
            share *= SHORTENING
        return None

    def _step(self, error_sds: Mapping[str, float], scoring: Scoring, names: list[str]) -> _Step:
        """The step of Fisher scoring in the variances of some components, none of them negative or
        larger than its `largest`."""
        slope, information = scoring.slope(self.residual), scoring.information
        unit = np.array([self.rig_errors.prior_sds[name] ** 2 for name in names])
        slope, information = slope * unit - 0.5, information * np.outer(unit, unit)
        start = np.array([error_sds[name] ** 2 for name in names]) / unit
        scale = np.sqrt(np.maximum(np.diag(information), LEAST_EIGENVALUE))
        eigenvalues, eigenvectors = np.linalg.eigh(information / np.outer(scale, scale))
        root = np.sqrt(np.maximum(eigenvalues, LEAST_EIGENVALUE))[:, None] * eigenvectors.T * scale
        optimum = np.linalg.solve(root.T, information @ start + slope)
        largest = [COMPONENTS[name].largest ** 2 for name in names]
        variances = np.minimum(nnls(root, optimum)[0], largest)
        positive = np.flatnonzero(variances)
        covariance = np.linalg.inv((root.T @ root)[np.ix_(positive, positive)])
        gains = {
            names[i]: float(0.5 * variances[i] ** 2 / uncertainty)
            for i, uncertainty in zip(positive, np.diag(covariance), strict=True)
        }
        step = variances - start
        promise = float(slope @ step - 0.5 * step @ information @ step)
        target = dict(zip(names, np.sqrt(variances * unit).tolist(), strict=True))
        return _Step(target, gains, promise)
