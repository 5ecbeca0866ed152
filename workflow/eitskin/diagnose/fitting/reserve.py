"""A fit judged by the reserve: readings that were put aside before anything was looked at."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.fit import Fit, Problem, difference
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.fitting.held_out import HeldOut, put_aside
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.noise.whitening import Whitening


@dataclass(frozen=True)
class Reserve:
    """The readings of the reserve; where there is none, those of the fit.

    problem: of the reserve's readings, with touches where they are reported to be and noise alone
    in its covariance; error_sds: of the rig's errors, as the final fit has them, for the fit before
    and after; converter_step: of the readings, 0 where unknown; units (N, M): labels of readings
    that err together (`held_out.units`).
    """

    problem: Problem
    error_sds: Mapping[str, float]
    converter_step: float
    units: np.ndarray
    _transferred: dict[int, tuple[Fit, Fit]] = field(default_factory=dict, repr=False)
    _predictions: dict[int, tuple[Fit, HeldOut]] = field(default_factory=dict, repr=False)

    @property
    def white(self) -> Whitening:
        """The covariance of noise alone."""
        return self.problem.whitening

    def transferred(self, fit: Fit) -> Fit:
        """A fit's values in the problem of the reserve: noise and the rig's errors in its
        covariance, these linearised where the readings have the touches."""
        if id(fit) not in self._transferred:
            moved = replace(fit, problem=self.problem)
            rig = linearised_rig_errors(moved, self.white, self.converter_step)
            model = touches.followed(self.problem, moved, rig, self.error_sds)
            recorded = self.problem.recorded
            if model is not self.problem.model:
                moved = replace(fit, problem=replace(self.problem, model=model))
                rig = linearised_rig_errors(moved, self.white, self.converter_step)
                recorded = recorded + rig.response(touches.moved(model, self.problem.model))
            whitening = rig.whitening(self.error_sds, discrepancy=False, fitted=True)
            problem = Problem(model, recorded, whitening)
            self._transferred[id(fit)] = fit, replace(fit, problem=problem)
        return self._transferred[id(fit)][1]

    def predicted(self, fit: Fit) -> HeldOut:
        """What a fit predicts for the reserve, noise and rig errors in its covariance; plain: with
        touches where they are reported to be."""
        if id(fit) not in self._predictions:
            plain = self.predicted_in_white(fit).plain
            prediction = replace(put_aside(self.transferred(fit)), plain=plain)
            self._predictions[id(fit)] = fit, prediction
        return self._predictions[id(fit)][1]

    def predicted_in_white(self, fit: Fit) -> HeldOut:
        """What a fit predicts for the reserve, against noise alone."""
        return put_aside(replace(fit, problem=self.problem))

    def p_value(self, fit: Fit, noise_dof: float) -> float:
        """Probability of a chi squared of the reserve at least as large, if the fit is right but
        for what its coordinates' covariance leaves open.

        The covariance must hold no discrepancy: that would accept what has no name. noise_dof:
        degrees of freedom of the noise's scale. 0 for another instrument than its owner's, which
        leaves open whatever it does not explain.
        """
        if replaces_instrument(fit.effects):
            return 0.0
        moved = self.transferred(fit)
        prediction, count = self.predicted(fit), moved.problem.whitening.size
        columns = _coordinate_errors(moved)
        gram = columns @ columns.T
        expected = 1.0 + np.trace(gram) / count
        variance = 2.0 * (count + 2.0 * np.trace(gram) + (gram**2).sum()) / count**2
        variance += 2.0 * expected**2 / max(noise_dof, 1.0)
        return float(norm.sf((prediction.chi2_per_dof - expected) / np.sqrt(variance)))

    def gain(self, fit: Fit, rival: Fit) -> tuple[float, float]:
        """Log density of the reserve by a fit above that by a rival, nats, and its standard
        error."""
        return self.predicted(fit).gain(self.predicted(rival))

    def gain_over_presses(self, after: Fit, before: Fit, folds: tuple[HeldOut, HeldOut]) -> float:
        """Gain of log density by a fit above another less its standard error by the scatter over
        presses, those of the reserve and those of folds, nats.

        It is negative where presses lose much of what others gain, so that the next may go either
        way: what one press gains alone, others nothing, is as large as its scatter. Infinite where
        fewer than two presses are known whole: folds are of channels or of stretches of time then.
        """
        model = self.problem.model
        reserved = self.white.mask.any(axis=1)
        fitted = after.problem.whitening.mask.any(axis=1)
        label = self.units[:, 0]
        presses = np.unique(label[model.touched & model.known & (reserved | fitted)])
        if len(presses) < 2:
            return np.inf
        of_frame = np.where(fitted, folds[0].density - folds[1].density, 0.0)
        if not np.array_equal(self.white.mask, after.problem.whitening.mask):
            density = self.predicted(after).density - self.predicted(before).density
            of_frame += np.where(reserved, density, 0.0)
        gain = np.array([of_frame[label == press].sum() for press in presses])
        return float(gain.sum() - np.sqrt(len(gain) * gain.var(ddof=1)))

    def harm(
        self, after: Fit, before: Fit, folds: tuple[HeldOut, HeldOut]
    ) -> tuple[float, float, float]:
        """How much worse a fit predicts readings than another, those of the reserve and, by folds,
        those of the fit: rms error of both in the recording's unit, and by how many standard errors
        the squared error grows (NaN where one unit has none)."""
        reserved, fitted = self.white.mask, after.problem.whitening.mask
        residual, residual_before = (
            np.where(
                reserved,
                self.predicted_in_white(fit).plain,
                np.where(fitted, fold.plain, np.nan),
            )
            for fit, fold in zip((after, before), folds, strict=True)
        )
        zero = np.where(reserved | fitted, 0.0, np.nan)
        comparison = harm(residual, residual_before, zero, self.units)
        return comparison["rmse_V"], comparison["rmse_before_V"], comparison["standard_errors"]


def _coordinate_errors(fit: Fit) -> np.ndarray:
    """(P, D): what independent unit errors of a fit's coordinates do to its readings, whitened."""

    def voltage(theta: np.ndarray) -> np.ndarray:
        return fit.problem.voltage(theta, fit.effects)

    start, whitening = voltage(fit.theta), fit.problem.whitening
    derivatives = [difference(voltage, fit.theta, start, i) for i in range(len(fit.theta))]
    slopes = np.array([whitening(column).ravel() for column in derivatives])
    return fit.root.T @ slopes.reshape(len(fit.theta), -1)
