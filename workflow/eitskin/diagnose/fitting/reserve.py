"""Fits evaluated on the reserve: readings that were set apart before anything was looked at."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.fit import Fit, Problem, difference
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.fitting.held_out import HeldOut, predict_unseen
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.noise.whitening import Whitening


@dataclass(frozen=True)
class Reserve:
    """The reserved readings; where there are none, those of the fit.

    problem: of the reserved readings, with touches as reported and noise alone in its covariance;
    error_sds: standard deviations of the rig's errors by name, of the final fit, used for every fit
    so that they compare; converter_step: of the readings, 0 where unknown; units (N, M): labels of
    independent units (`held_out.error_units`).
    """

    problem: Problem
    error_sds: Mapping[str, float]
    converter_step: float
    units: np.ndarray
    _transferred: dict[int, tuple[Fit, Fit]] = field(default_factory=dict, repr=False)
    _predictions: dict[int, tuple[Fit, HeldOut]] = field(default_factory=dict, repr=False)

    @property
    def noise_whitening(self) -> Whitening:
        """The covariance of noise alone."""
        return self.problem.whitening

    def transfer(self, fit: Fit) -> Fit:
        """A fit with the problem of the reserve: noise and the rig's errors in its covariance,
        these linearised about the touches of `touches.relocated_touches`."""
        if id(fit) not in self._transferred:
            transferred = replace(fit, problem=self.problem)
            rig = linearised_rig_errors(transferred, self.noise_whitening, self.converter_step)
            model = touches.relocated_touches(self.problem, transferred, rig, self.error_sds)
            readings = self.problem.readings
            if model is not self.problem.model:
                transferred = replace(fit, problem=replace(self.problem, model=model))
                rig = linearised_rig_errors(transferred, self.noise_whitening, self.converter_step)
                readings = readings + rig.response(touches.displacements(model, self.problem.model))
            whitening = rig.whitening(self.error_sds, discrepancy=False, fitted=True)
            problem = Problem(model, readings, whitening)
            self._transferred[id(fit)] = fit, replace(fit, problem=problem)
        return self._transferred[id(fit)][1]

    def prediction(self, fit: Fit) -> HeldOut:
        """A fit's prediction of the reserve, with noise and the rig's errors in the covariance; its
        `residual` is that with touches as reported."""
        if id(fit) not in self._predictions:
            residual = self.noise_prediction(fit).residual
            prediction = replace(predict_unseen(self.transfer(fit)), residual=residual)
            self._predictions[id(fit)] = fit, prediction
        return self._predictions[id(fit)][1]

    def noise_prediction(self, fit: Fit) -> HeldOut:
        """A fit's prediction of the reserve, with noise alone in the covariance."""
        return predict_unseen(replace(fit, problem=self.problem))

    def p_value(self, fit: Fit, noise_dof: float) -> float:
        """Probability of a chi squared of the reserve at least as large, if the fit is right within
        the covariance of its coordinates; by a normal approximation.

        The covariance of the readings must hold no discrepancy, with which any misfit is probable.
        noise_dof: degrees of freedom of the noise's scale. 0 for a fit with another instrument than
        the owner's, whose coordinates can explain any misfit.
        """
        if replaces_instrument(fit.effects):
            return 0.0
        transferred = self.transfer(fit)
        prediction, count = self.prediction(fit), transferred.problem.whitening.size
        columns = _coordinate_errors(transferred)
        gram = columns @ columns.T
        expected = 1.0 + np.trace(gram) / count
        variance = 2.0 * (count + 2.0 * np.trace(gram) + (gram**2).sum()) / count**2
        variance += 2.0 * expected**2 / max(noise_dof, 1.0)
        return float(norm.sf((prediction.chi2_per_dof - expected) / np.sqrt(variance)))

    def gain(self, fit: Fit, rival: Fit) -> tuple[float, float]:
        """Log density of the reserve by a fit less that by a rival, in nats, and its standard
        error."""
        return self.prediction(fit).gain(self.prediction(rival))

    def gain_over_presses(self, fit: Fit, baseline: Fit, folds: tuple[HeldOut, HeldOut]) -> float:
        """Gain of log density of a fit over a baseline, less its standard error by the scatter over
        presses, in nats; presses of the reserve, and those of the fit by `folds`, the
        cross-validations of fit and baseline.

        It is negative where some presses lose what others gain, and 0 where one press has all of
        the gain: the next press may go either way. Infinite with fewer than two presses whose
        states are known: folds are of channels or of stretches of time then.
        """
        model = self.problem.model
        reserved = self.noise_whitening.mask.any(axis=1)
        fitted = fit.problem.whitening.mask.any(axis=1)
        label = self.units[:, 0]
        presses = np.unique(label[model.touched & model.simulable & (reserved | fitted)])
        if len(presses) < 2:
            return np.inf
        frame_gain = np.where(fitted, folds[0].log_density - folds[1].log_density, 0.0)
        if not np.array_equal(self.noise_whitening.mask, fit.problem.whitening.mask):
            density = self.prediction(fit).log_density - self.prediction(baseline).log_density
            frame_gain += np.where(reserved, density, 0.0)
        gain = np.array([frame_gain[label == press].sum() for press in presses])
        return float(gain.sum() - np.sqrt(len(gain) * gain.var(ddof=1)))

    def harm(
        self, fit: Fit, baseline: Fit, folds: tuple[HeldOut, HeldOut]
    ) -> tuple[float, float, float]:
        """Rms error of a fit's and of a baseline's predictions, in the recording's unit, and by how
        many standard errors the fit's squared error is the larger (NaN with one unit). Readings of
        the reserve, and those of the fit by `folds`, the cross-validations of fit and baseline."""
        reserved_mask, fitted_mask = self.noise_whitening.mask, fit.problem.whitening.mask
        residual, baseline_residual = (
            np.where(
                reserved_mask,
                self.noise_prediction(predictor).residual,
                np.where(fitted_mask, fold.residual, np.nan),
            )
            for predictor, fold in zip((fit, baseline), folds, strict=True)
        )
        zero = np.where(reserved_mask | fitted_mask, 0.0, np.nan)
        comparison = harm(residual, baseline_residual, zero, self.units)
        return comparison["rmse_V"], comparison["rmse_before_V"], comparison["standard_errors"]


def _coordinate_errors(fit: Fit) -> np.ndarray:
    """(P, D): whitened changes of a fit's D readings by P independent standard errors of its
    coordinates."""

    def voltage(theta: np.ndarray) -> np.ndarray:
        return fit.problem.voltage(theta, fit.effects)

    start, whitening = voltage(fit.theta), fit.problem.whitening
    derivatives = [difference(voltage, fit.theta, start, i) for i in range(len(fit.theta))]
    slopes = np.array([whitening(column).ravel() for column in derivatives])
    return fit.root.T @ slopes.reshape(len(fit.theta), -1)
