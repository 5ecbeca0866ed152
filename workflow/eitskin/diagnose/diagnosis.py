"""A recording diagnosed, from noise and calibration to search and remainder."""

import sys
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from eitskin.data.recording import Recording, voltages
from eitskin.diagnose.fitting.candidates import replaces_instrument
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB, excerpt
from eitskin.diagnose.fitting.fit import Fit, fit, whitened_anew
from eitskin.diagnose.fitting.memory import most_frames
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.noise.estimate import Noise
from eitskin.diagnose.noise.rig import Rig
from eitskin.diagnose.noise.rig_sizes import findings
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.growth import cut_short
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.prediction import is_unlike, likeness
from eitskin.diagnose.search.proposals import refused_p_value
from eitskin.diagnose.search.refits import without_discrepancy
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.staging import prepared, pruned_by_reserve, searched
from eitskin.diagnose.verdict.atlas import atlas
from eitskin.diagnose.verdict.gaps import Gap, gaps, strengths
from eitskin.diagnose.verdict.remainder import Other, other, unlike
from eitskin.diagnose.verdict.rivals import Rival, rivals
from eitskin.effects.effect import Setting
from eitskin.physics import outline


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
    noise: Noise
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


def diagnose(
    recording: Recording,
    seed: int = 1,
    progress: bool = False,
    memory_GiB: float = LIMIT_GIB,
    earlier: list[Setting] | None = None,
    opened: frozenset[tuple[str, str]] = frozenset(),
) -> Diagnosis:
    """Diagnose a recording: locate, name and model what its simulation leaves out.

    Of a long recording, an excerpt, as long as memory_GiB are expected to allow; a search on a few
    frames of it is where that on all begins, or the effects of an earlier diagnosis where these
    explain it: each has to be borne out. opened: pairs of a gate's and an effect's name, for which
    the gate lets everything pass. Equal arguments give equal results, bit for bit. Raises
    InputError where nothing can be simulated, and where it would take more memory.
    """
    # Shared out among cores, small products take longer, and their sums are of other bytes.
    with threadpool_limits(1, user_api="blas"):
        return _diagnosed(recording, seed, progress, memory_GiB, earlier, Journal(opened))


def _diagnosed(
    recording: Recording,
    seed: int,
    progress: bool,
    memory_GiB: float,
    earlier: list[Setting] | None,
    journal: Journal,
) -> Diagnosis:
    voltages(recording, "recording")
    outline.refuse(recording.skin, "recording")

    def report(line: str) -> None:
        if progress:
            print(f"  {line}", file=sys.stderr, flush=True)

    count = len(recording.frames)
    recording = excerpt(recording, most_frames(recording, memory_GiB))
    if len(recording.frames) < count:
        report(f"an excerpt: {len(recording.frames)} of {count} frames")
    noise, search, reserve_mask = prepared(recording, seed, report, journal)
    problem = search.problem
    outcome, was_cut_short = searched(recording, search, seed, earlier)
    (search, before, after), reserve = pruned_by_reserve(
        outcome, problem, recording, noise, reserve_mask
    )
    catalogue_p = refused_p_value(search, after)
    if not after.effects:
        before = after
    rig = Rig.about(after.fit, search.problem.whitening, noise.step)
    report("comparing with every other name")
    distances = [gaps(search, after, i) for i in range(len(after.effects))]
    if search.spent or was_cut_short:
        cut_short(search, after)
    named = _named(after, problem.whitening)
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
        findings(rig, after.error_sds, after.fit.misfit, unit, noise),
        _atlas(recording, noise, _named(before, problem.whitening)),
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
        return whitened_anew(explanation.fit, problem)
    named = without_discrepancy(explanation, explanation.fit)
    if named is explanation.fit:
        return named
    return fit(named.problem, named.effects, named.theta, named.jacobian, polish=True)


def _atlas(recording: Recording, noise: Noise, fitted: Fit) -> pd.DataFrame:
    mask = fitted.problem.whitening.mask
    simulated = np.where(mask, fitted.voltage(), np.nan)
    columns = fitted.jacobian.reshape(len(fitted.theta), -1).T
    residual = np.where(mask, fitted.residual, np.nan)
    return atlas(recording, residual, simulated / noise.sd, columns)
