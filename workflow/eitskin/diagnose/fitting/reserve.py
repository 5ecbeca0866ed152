"""Fits evaluated on the reserve: readings that were set apart before anything was looked at, and
are read after everything is decided."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.fit import Fit, Problem
from eitskin.diagnose.fitting.held_out import HeldOut, predict_unseen
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.noise.whitening import Whitening


@dataclass(frozen=True)
class Reserve:
    """The reserved readings.

    problem: of these, with touches as reported and noise alone in its covariance; error_sds:
    standard deviations of the rig's errors by name, used for every fit so that they compare;
    converter_step: of the readings, 0 where unknown.
    """

    problem: Problem
    error_sds: Mapping[str, float]
    converter_step: float

    @property
    def noise_whitening(self) -> Whitening:
        """The covariance of noise alone."""
        return self.problem.whitening

    def transfer(self, fit: Fit) -> Fit:
        """A fit with the problem of the reserve: noise and the rig's errors in its covariance,
        these linearised about the touches of `touches.relocated_touches`."""
        transferred = replace(fit, problem=self.problem)
        rig = linearised_rig_errors(transferred, self.noise_whitening, self.converter_step)
        model = touches.relocated_touches(self.problem, transferred, rig, self.error_sds)
        readings = self.problem.readings
        if model is not self.problem.model:
            transferred = replace(fit, problem=replace(self.problem, model=model))
            rig = linearised_rig_errors(transferred, self.noise_whitening, self.converter_step)
            readings = readings + rig.response(touches.displacements(model, self.problem.model))
        whitening = rig.whitening(self.error_sds, discrepancy=False, fitted=True)
        return replace(fit, problem=Problem(model, readings, whitening))

    def prediction(self, fit: Fit) -> HeldOut:
        """A fit's prediction of the reserve, with noise and the rig's errors in the covariance; its
        `residual` is that with touches as reported."""
        residual = self.noise_prediction(fit).residual
        return replace(predict_unseen(self.transfer(fit)), residual=residual)

    def noise_prediction(self, fit: Fit) -> HeldOut:
        """A fit's prediction of the reserve, with noise alone in the covariance."""
        return predict_unseen(replace(fit, problem=self.problem))
