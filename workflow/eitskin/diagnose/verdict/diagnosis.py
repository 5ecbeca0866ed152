"""What follows from a finished search: gaps to other names, atlases of residuals, the remainder."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.fit import Fit, Problem, rewhitened
from eitskin.diagnose.fitting.held_out import CrossValidation, held_out
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.noise.component_sds import component_intervals
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import NOTHING_UNNAMED
from eitskin.diagnose.search.growth import Outcome, cut_short
from eitskin.diagnose.search.prediction import is_unlike, likeness, named_prediction
from eitskin.diagnose.search.refits import named_fit
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.atlas import atlas
from eitskin.diagnose.verdict.common_parts import with_common_parts
from eitskin.diagnose.verdict.gaps import Gap, gaps, strengths
from eitskin.diagnose.verdict.passing import discovered, without_passing
from eitskin.diagnose.verdict.remainder import Remainder, remainder, unlike_remainder
from eitskin.diagnose.verdict.rivals import Rival, rivals


@dataclass(frozen=True)
class Diagnosis:
    """What explains one recording, and what that was tested with.

    recording: as it was diagnosed, an excerpt of a long one or averages; search: as it ended;
    baseline, explanation: without effects and with them; noise_problem: with noise alone in its
    covariance; reserve_mask (N, M): readings that no decision read; rig_errors: with their sds, as
    diagnosis.json has them; baseline_atlas, atlas: of the residuals of both; named_fit: that of the
    explanation, nothing without a name in its covariance; gaps: of every effect, the nearest rival
    first; strengths: SNR of every name at a typical size. parts, steps: of a recording with steps
    in time, as diagnosis.json has them; this is the diagnosis of the part with the key `told`.
    unlabelled: numbers of the first and last frame of stretches that were left out, for somebody
    touched in them though no label tells. frames_each: how many frames each of the recording's is
    the average of.
    """

    recording: Recording
    search: Search
    noise: NoiseModel
    baseline: Explanation
    explanation: Explanation
    noise_problem: Problem
    reserve_mask: np.ndarray
    rig_errors: list[dict]
    baseline_atlas: pd.DataFrame
    atlas: pd.DataFrame
    named_fit: Fit
    gaps: list[list[Gap]]
    strengths: dict[str, float]
    remainder: Remainder
    parts: tuple[dict, ...] = ()
    steps: tuple[dict, ...] = ()
    unlabelled: tuple[tuple[int, int], ...] = ()
    frames_each: float = 1.0

    @cached_property
    def rivals(self) -> list[list[Rival]]:
        """What else could be in the place of each effect."""
        count = len(self.explanation.effects)
        return [rivals(self.search, self.explanation, i) for i in range(count)]

    @cached_property
    def prediction(self) -> CrossValidation:
        """What the explanation predicts for the folds left out, in the covariance of `named_fit`,
        as all that is compared with it there."""
        return named_prediction(self.explanation, self.named_fit)

    @cached_property
    def excess_chi2(self) -> float:
        """Chi squared of the folds left out, beyond their number, that the baseline leaves."""
        baseline = self.prediction_by(self.baseline)
        return float(baseline.chi2.sum() - baseline.reading_count)

    def returned_share(self, prediction: CrossValidation) -> float:
        """Share of `excess_chi2` that returns with a prediction by less than is named, of 0 to
        1."""
        returned = prediction.chi2.sum() - self.prediction.chi2.sum()
        share = returned / self.excess_chi2 if self.excess_chi2 > 0.0 else 0.0
        return float(np.clip(share, 0.0, 1.0))

    def prediction_by(self, explanation: Explanation) -> CrossValidation:
        """What another explanation predicts for them in that covariance. Raises InputError where it
        has no physics where touches were displaced to."""
        if explanation is self.explanation:
            return self.prediction
        fitted = rewhitened(explanation.fit, self.named_fit.problem)
        return held_out(fitted, self.search.folds)


@dataclass(frozen=True)
class Data:
    """A recording with its noise, as a search had them.

    reserve_mask (N, M): readings that the search did not see; noise_problem: of the others, with
    noise alone in its covariance.
    """

    recording: Recording
    noise: NoiseModel
    reserve_mask: np.ndarray
    noise_problem: Problem

    def residual_atlas(
        self, explanation: Explanation, fitted: Fit, passing: pd.DataFrame | None = None
    ) -> pd.DataFrame:
        """The atlas of the residual of a fit of an explanation, with what the rig's errors move in
        a frame free in every frame; passing: an atlas of it, of which what passes is taken out."""
        rig = explanation.rig
        if rig is not None and not replaces_instrument(explanation.effects):
            sds = rig.free_in_frames(explanation.error_sds)
            whitening = rig.whitening(sds, discrepancy=False, fitted=True)
            fitted = rewhitened(fitted, replace(fitted.problem, whitening=whitening))
        mask = fitted.problem.whitening.mask
        simulated = np.where(mask, fitted.voltage(), np.nan)
        columns = fitted.jacobian.reshape(len(fitted.theta), -1).T
        residual = np.where(mask, fitted.residual, np.nan)
        if passing is not None:
            residual = without_passing(self.recording, residual, passing)
        simulated = simulated / self.noise.sd
        return atlas(self.recording, residual, simulated, columns, self.noise.dof)

    def named_fit(self, explanation: Explanation) -> Fit:
        """The fit of an explanation where nothing without a name is in its covariance; beside
        another instrument such a covariance has the noise alone."""
        if replaces_instrument(explanation.effects):
            problem = replace(explanation.fit.problem, whitening=self.noise_problem.whitening)
            return rewhitened(explanation.fit, problem)
        return named_fit(explanation)


def assess(data: Data, outcome: Outcome, was_cut_short: bool) -> Diagnosis:
    """The diagnosis that follows from the outcome of a search; was_cut_short: whether a stage of
    the search was."""
    search, baseline, explanation = outcome
    if not explanation.effects and not search.problem.model.families:
        baseline = explanation
    step, unit = data.noise.converter_step, data.recording.metadata["unit"]
    rig = linearised_rig_errors(explanation.fit, search.problem.whitening, step)
    search.report("comparing with every other name")
    distances = [gaps(search, explanation, i) for i in range(len(explanation.effects))]
    if search.spent or was_cut_short:
        cut_short(search, explanation)
    named = data.named_fit(explanation)
    residual_atlas = data.residual_atlas(explanation, named)
    unnamed = _remainder(search, explanation, residual_atlas)
    if not (NOTHING_UNNAMED.admits(unnamed.probability) or discovered(residual_atlas).empty):
        # An alarm must last without what changes with time alone, or in one press alone.
        lasting_atlas = data.residual_atlas(explanation, named, residual_atlas)
        lasting = _remainder(search, explanation, lasting_atlas)
        unnamed = lasting if NOTHING_UNNAMED.admits(lasting.probability) else unnamed
    components = with_common_parts(
        component_intervals(rig, explanation.error_sds, unit, data.noise),
        explanation.fit,
        rig,
        explanation.error_sds,
    )
    return Diagnosis(
        recording=data.recording,
        search=search,
        noise=data.noise,
        baseline=baseline,
        explanation=explanation,
        noise_problem=data.noise_problem,
        reserve_mask=data.reserve_mask,
        rig_errors=components,
        baseline_atlas=data.residual_atlas(baseline, data.named_fit(baseline)),
        atlas=residual_atlas,
        named_fit=named,
        gaps=distances,
        strengths=strengths(search, explanation),
        remainder=unnamed,
    )


def _remainder(search: Search, explanation: Explanation, residual_atlas: pd.DataFrame) -> Remainder:
    """The remainder of an explanation, by the atlas of its residual."""
    if is_unlike(search, explanation):
        return unlike_remainder(likeness(search, explanation))
    return remainder(residual_atlas)
