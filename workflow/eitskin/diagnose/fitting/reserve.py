"""A fit judged by readings that no fit has seen: how well it predicts them, if it does harm."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.fit import Fit, Problem, difference
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.fitting.held_out import HeldOut, put_aside
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search.fitting import STANDARD_ERRORS
from eitskin.diagnose.search.resorts import foreign

MOST_RATIO = 1.05  # of the rms errors with and without an effect


@dataclass(frozen=True)
class Judged:
    """Readings put aside, of the frames of `problem`, which has touches where they are said to be
    and noise alone in its covariance; where none could be put aside, those of the fit. sizes: of
    the rig's errors, as the final fit has them, before and after; converter_step: as in
    `NoiseModel`; unit: as of `units`."""

    problem: Problem
    sizes: Mapping[str, float]
    converter_step: float
    unit: np.ndarray
    _about: dict[int, tuple[Fit, Fit]] = field(default_factory=dict, repr=False)
    _by: dict[int, tuple[Fit, HeldOut]] = field(default_factory=dict, repr=False)

    @property
    def white(self) -> Whitening:
        """The covariance of noise alone."""
        return self.problem.whitening

    def about(self, fit: Fit) -> Fit:
        """A fit set to what was put aside: noise and the rig's errors in its covariance, these in
        proportion about where the readings have the touches."""
        if id(fit) not in self._about:
            there = replace(fit, problem=self.problem)
            rig = linearised_rig_errors(there, self.white, self.converter_step)
            model = touches.followed(self.problem, there, rig, self.sizes)
            recorded = self.problem.recorded
            if model is not self.problem.model:
                there = replace(fit, problem=replace(self.problem, model=model))
                rig = linearised_rig_errors(there, self.white, self.converter_step)
                recorded = recorded + rig.response(touches.moved(model, self.problem.model))
            whitening = rig.whitening(self.sizes, discrepancy=False, fitted=True)
            problem = Problem(model, recorded, whitening)
            self._about[id(fit)] = fit, replace(fit, problem=problem)
        return self._about[id(fit)][1]

    def by(self, fit: Fit) -> HeldOut:
        """What a fit predicts for them, with noise and rig errors in their covariance; plain: where
        touches are said to be."""
        if id(fit) not in self._by:
            found = replace(put_aside(self.about(fit)), plain=self.by_white(fit).plain)
            self._by[id(fit)] = fit, found
        return self._by[id(fit)][1]

    def by_white(self, fit: Fit) -> HeldOut:
        """What a fit predicts for them, against noise alone."""
        return put_aside(replace(fit, problem=self.problem))

    def p_value(self, fit: Fit, noise_dof: float) -> float:
        """How probable a chi squared at least as large is, if the fit is right but for what its
        coordinates' covariance leaves open, which must hold no discrepancy: that would accept what
        has no name. noise_dof: degrees of freedom of the noise's scale. 0 for another instrument
        than its owner's, which leaves open whatever it does not explain."""
        if foreign(fit.effects):
            return 0.0
        there = self.about(fit)
        found, count = self.by(fit), there.problem.whitening.size
        along = _open(there)
        gram = along @ along.T
        expected = 1.0 + np.trace(gram) / count
        variance = 2.0 * (count + 2.0 * np.trace(gram) + (gram**2).sum()) / count**2
        variance += 2.0 * expected**2 / max(noise_dof, 1.0)
        return float(norm.sf((found.chi2_per_dof - expected) / np.sqrt(variance)))

    def gain(self, fit: Fit, other: Fit) -> tuple[float, float]:
        """Log density of a fit above another's, and its standard error."""
        return self.by(fit).gain(self.by(other))

    def in_common(self, after: Fit, before: Fit, folds: tuple[HeldOut, HeldOut]) -> float:
        """A fit's gain of log density above another's less its standard error by the scatter over
        presses, those put aside and those of folds: negative where presses lose much of what others
        gain, so that the next may go either way. What one press gains alone, others nothing, is as
        large as its scatter. Infinite where fewer than two presses are known whole: folds are of
        channels or of stretches of time then."""
        model = self.problem.model
        aside, seen = self.white.mask.any(axis=1), after.problem.whitening.mask.any(axis=1)
        label = self.unit[:, 0]
        presses = np.unique(label[model.touched & model.known & (aside | seen)])
        if len(presses) < 2:
            return np.inf
        own = np.where(seen, folds[0].density - folds[1].density, 0.0)
        if not np.array_equal(self.white.mask, after.problem.whitening.mask):
            own += np.where(aside, self.by(after).density - self.by(before).density, 0.0)
        gain = np.array([own[label == one].sum() for one in presses])
        return float(gain.sum() - np.sqrt(len(gain) * gain.var(ddof=1)))

    def harms(
        self, after: Fit, before: Fit, folds: tuple[HeldOut, HeldOut], believed: bool
    ) -> bool:
        """Whether a fit predicts readings plainly worse than another: in the recording's unit,
        those put aside and, of folds, those of the frames that the search saw. Worse is a ratio
        of the errors over MOST_RATIO, or a growth of more than STANDARD_ERRORS; both at once where
        the covariance accepts what is left, as it says that places and forces are off by so much
        (`believed`). One unit has no standard error."""
        aside, seen = self.white.mask, after.problem.whitening.mask
        left, left_before = (
            np.where(aside, self.by_white(fit).plain, np.where(seen, fold.plain, np.nan))
            for fit, fold in zip((after, before), folds, strict=True)
        )
        found = harm(left, left_before, np.where(aside | seen, 0.0, np.nan), self.unit)
        larger = found["rmse_V"] > MOST_RATIO * found["rmse_before_V"]
        clear = found["standard_errors"] > STANDARD_ERRORS
        return larger and clear if believed else larger or clear


def _open(fit: Fit) -> np.ndarray:
    """(P, D): what independent unit errors of a fit's coordinates do to its readings, whitened."""

    def voltage(theta: np.ndarray) -> np.ndarray:
        return fit.problem.voltage(theta, fit.effects)

    there, whitening = voltage(fit.theta), fit.problem.whitening
    moved = [difference(voltage, fit.theta, there, i) for i in range(len(fit.theta))]
    slopes = np.array([whitening(one).ravel() for one in moved])
    return fit.root.T @ slopes.reshape(len(fit.theta), -1)
