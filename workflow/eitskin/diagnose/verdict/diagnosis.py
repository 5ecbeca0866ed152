"""What a finished search is judged by: gaps to other names, atlases of residuals, the remainder."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.fit import Fit, fit, rewhitened
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.noise.component_sds import component_intervals
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.growth import Outcome, cut_short
from eitskin.diagnose.search.prediction import is_unlike, likeness
from eitskin.diagnose.search.proposals import refused_p_value
from eitskin.diagnose.search.refits import without_discrepancy
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.atlas import atlas
from eitskin.diagnose.verdict.gaps import Gap, gaps, strengths
from eitskin.diagnose.verdict.remainder import Other, other, unlike
from eitskin.diagnose.verdict.rivals import Rival, rivals


@dataclass(frozen=True)
class Diagnosis:
    """What explains one recording, and what it was judged by.

    recording: as it was diagnosed, an excerpt of a long one; search: as it ended; before, after:
    the explanations without effects and with them; reserve_mask (N, M): readings that the search
    did not see; reserve: these, in the covariance of `after`; rig: its errors with their sds, as
    diagnosis.json has them; named: the fit of `after`, nothing without a name in its covariance;
    strengths: SNR of every name at a typical size. parts, steps: of a recording with steps in time,
    as diagnosis.json has them; the part that is `told` is what this is of.
    """

    recording: Recording
    search: Search
    noise: NoiseModel
    before: Explanation
    after: Explanation
    reserve_mask: np.ndarray
    reserve: Reserve
    rig: list[dict]
    atlas_before: pd.DataFrame
    atlas_after: pd.DataFrame
    named: Fit
    gaps: list[list[Gap]]
    strengths: dict[str, float]
    other: Other
    parts: tuple[dict, ...] = ()
    steps: tuple[dict, ...] = ()

    @cached_property
    def rivals(self) -> list[list[Rival]]:
        """What else could be in the place of each effect."""
        return [rivals(self.search, self.after, i) for i in range(len(self.after.effects))]


def assessed(
    recording: Recording,
    noise: NoiseModel,
    outcome: Outcome,
    reserve: Reserve,
    reserve_mask: np.ndarray,
    white: Whitening,
    was_cut_short: bool,
) -> Diagnosis:
    """The diagnosis that follows from the outcome of a search.

    reserve_mask (N, M): of the readings of the reserve; white: the covariance of the recording's
    noise alone; was_cut_short: whether a stage of the search was.
    """
    search, before, after = outcome
    catalogue_p = refused_p_value(search, after)
    if not after.effects:
        before = after
    rig = linearised_rig_errors(after.fit, search.problem.whitening, noise.converter_step)
    search.report("comparing with every other name")
    distances = [gaps(search, after, i) for i in range(len(after.effects))]
    if search.spent or was_cut_short:
        cut_short(search, after)
    named = _named(after, white)
    atlas_after = _atlas(recording, noise, named)
    remainder = _remainder(search, after, atlas_after, catalogue_p)
    unit = recording.metadata["unit"]
    return Diagnosis(
        recording,
        search,
        noise,
        before,
        after,
        reserve_mask,
        reserve,
        component_intervals(rig, after.error_sds, unit, noise),
        _atlas(recording, noise, _named(before, white)),
        atlas_after,
        named,
        distances,
        strengths(search, after),
        remainder,
    )


def _remainder(
    search: Search, after: Explanation, atlas_after: pd.DataFrame, catalogue_p: float
) -> Other:
    """What is said of what an explanation leaves, by the atlas of its residual."""
    if is_unlike(search, after):
        return unlike(likeness(search, after))
    return other(atlas_after, catalogue_p)


def _named(explanation: Explanation, white: Whitening) -> Fit:
    """An explanation's fit where nothing without a name is in its covariance; white: of the
    recording's noise alone, which is all that such a covariance has beside another instrument."""
    if replaces_instrument(explanation.effects):
        problem = replace(explanation.fit.problem, whitening=white)
        return rewhitened(explanation.fit, problem)
    named = without_discrepancy(explanation, explanation.fit)
    if named is explanation.fit:
        return named
    return fit(named.problem, named.effects, named.theta, named.jacobian, polish=True)


def _atlas(recording: Recording, noise: NoiseModel, fitted: Fit) -> pd.DataFrame:
    mask = fitted.problem.whitening.mask
    simulated = np.where(mask, fitted.voltage(), np.nan)
    columns = fitted.jacobian.reshape(len(fitted.theta), -1).T
    residual = np.where(mask, fitted.residual, np.nan)
    return atlas(recording, residual, simulated / noise.sd, columns)
