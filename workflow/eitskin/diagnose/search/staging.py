"""Where a search begins: whole, on few frames, on untouched frames, or from stated effects."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from eitskin.data.recording import Recording
from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.candidates import Candidate, replaces_instrument
from eitskin.diagnose.fitting.excerpt import excerpt
from eitskin.diagnose.fitting.families import members
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.held_out import draw_reserve_mask, folds
from eitskin.diagnose.fitting.readings import noise_and_problem
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search.catalogue import Conditions, catalogue
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import GROSS_MISFIT
from eitskin.diagnose.search.growth import Outcome, at_start, grown, run
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.refits import (
    DISCREPANCY,
    calibrated,
    forked,
    without_discrepancy,
)
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.effects.effect import Setting
from eitskin.effects.settings import site_counts

FIRST_FRAMES = 120  # on which the search begins, where there are twice as many
FIRST_SHARE = 2 / 3  # of the budget, that the search on these may take
# Where more than this share of the untouched readings is left unexplained, untouched frames are
# searched first, if there are so many of them, for this share of the budget.
UNTOUCHED_DISCREPANCY, LEAST_UNTOUCHED, UNTOUCHED_SHARE = 3e-3, 5, 1 / 3
EXPLAINED = 2.0  # chi squared a reading, up to which such a start is trusted


def prepared(
    recording: Recording,
    seed: int,
    report: Callable[[str], None] = lambda line: None,
    journal: Journal | None = None,
) -> tuple[NoiseModel, Search, np.ndarray]:
    """The noise of a recording; the search of its whole catalogue, which has not run; and the mask
    (N, M) of the reserve, chosen before anything is looked at. Raises InputError where nothing can
    be simulated."""
    reserve_mask = draw_reserve_mask(recording, seed)
    noise, problem, scales = noise_and_problem(recording, reserve_mask)
    model = problem.model
    report(f"noise {np.median(noise.sd):.3g} ({noise.source})")
    conditions = Conditions(
        recording.skin,
        model.nominal_skin,
        site_counts(recording.channels),
        floating=not model.sink_grounded,
        timed=recording.metadata["clock"] == "measured",
        touched=bool(model.touched.any()),
    )
    journal = journal or Journal()
    recorded_V = np.where(problem.whitening.mask, recording.readings, np.nan)
    candidates = catalogue(conditions, recorded_V, scales, journal)
    if not (conditions.touched or model.difference):
        problem = replace(problem, families=members(candidates, problem.readings.size))
        family_keys = {m.key for family in problem.families.values() for m in family}
        candidates = [c for c in candidates if c.scope != "dense" or c.key not in family_keys]
    search = Search(
        problem,
        [c for c in candidates if not c.effect.last_resort],
        _folds(problem, recording.channels, seed),
        seed,
        report,
        last_resorts=[c for c in candidates if c.effect.last_resort],
        learns_rig=True,
        converter_step=noise.converter_step,
        journal=journal,
    )
    return noise, search, reserve_mask


def _folds(problem: Problem, channels: np.ndarray, seed: int) -> np.ndarray:
    model = problem.model
    return folds(model.touched & model.simulable, model.press, channels, seed)


def searched(
    recording: Recording, search: Search, seed: int, stated: list[Setting] | None = None
) -> tuple[Outcome, bool]:
    """The outcome of a search of a recording, begun where it is cheapest, and whether a stage of it
    was cut short; stated: effects with which it begins where these explain the recording."""
    stated_start = _at_stated(search, stated) if stated else None
    if stated_start is not None:
        return grown(*stated_start), False
    mask = search.problem.whitening.mask
    fitted = replace(recording, voltage=np.where(mask, recording.readings, np.nan))
    start = _untouched_first(search, fitted, seed)
    if len(recording.frames) < 2 * FIRST_FRAMES:
        return run(search, start), False
    stages: list[Callable[[], tuple]] = [
        partial(_few_first, search, fitted, seed, start),
        partial(_calibrated_rig, search),
    ]
    (start, was_cut_short), (calibration, rig) = forked(search, lambda stage: stage(), stages)
    search = replace(search, rig=rig)
    search.report(f"then on {len(recording.frames)}")
    return run(search, start, calibration), was_cut_short


def _calibrated_rig(search: Search) -> tuple:
    """The calibrated explanation, and the rig's errors about it."""
    search, calibration = calibrated(search)
    return calibration, search.rig


def _on_frames(
    search: Search, recording: Recording, part: Recording, seed: int, share: float
) -> Search:
    """A search like that of a recording, on the frames of an excerpt of it."""
    problem = search.problem
    model = RecordingSimulator(part, problem.model, problem.model.solved_skins)
    readings = np.where(model.simulable[:, None], part.readings, np.nan)
    clock = part.frames["frame"].to_numpy()
    whitening = replace(problem.whitening, mask=np.isfinite(readings), frame_number=clock)
    problem = Problem(model, readings, whitening)
    candidates: list[Candidate] = [*search.candidates, *search.last_resorts]
    return Search(
        problem,
        [c for c in candidates if not c.effect.last_resort],
        _folds(problem, recording.channels, seed),
        seed,
        search.report,
        last_resorts=[c for c in candidates if c.effect.last_resort],
        budget_share=share,
        learns_rig=True,
        converter_step=search.converter_step,
        journal=Journal(search.journal.opened),
    )


def _at_stated(
    search: Search, stated: list[Setting]
) -> tuple[Search, Explanation, Explanation] | None:
    """The search, its calibrated explanation, and one of stated effects; None, and a line of it,
    where these do not explain the recording: far from its optimum a search would go astray."""
    names = ", ".join(setting.effect.name for setting in stated)
    search.report(f"first what was found earlier: {names}")
    start = StartingPoint.from_settings(stated, search.candidates, search.problem)
    if start is None:
        search.report("not all of it is sought in this recording; begun anew")
        return None
    calibrated_search, calibration = calibrated(search)
    begin = at_start(calibrated_search, calibration, start)
    limit = EXPLAINED * search.problem.whitening.size
    if begin is None or without_discrepancy(begin, begin.fit).chi2 > limit:
        search.report("it does not explain this recording; begun anew")
        return None
    return calibrated_search, calibration, begin


def _few_first(
    search: Search, recording: Recording, seed: int, start: StartingPoint | None
) -> tuple[StartingPoint, bool]:
    """The effects that FIRST_FRAMES frames show, from a start, and whether the search on them was
    cut short."""
    part = excerpt(recording, FIRST_FRAMES)
    search.report(f"first on {len(part.frames)} frames")
    on_few = _on_frames(search, recording, part, seed, FIRST_SHARE)
    on_few, _, after = run(on_few, start)
    return StartingPoint.from_explanation(after), on_few.spent


def _untouched_first(search: Search, recording: Recording, seed: int) -> StartingPoint | None:
    """The effects that explain the frames in which nobody touches, where more than
    UNTOUCHED_DISCREPANCY of their readings is unexplained: so far off, touches would be followed to
    anywhere. None where nothing does: a wrong name would stay."""
    model = search.problem.model
    count = int((~model.touched).sum())
    if model.difference or count < LEAST_UNTOUCHED or not model.touched.any():
        return None
    part = of_frames(recording, ~model.touched)
    untouched = _on_frames(search, recording, part, seed, UNTOUCHED_SHARE)
    plain = fit(untouched.problem, [], np.zeros(len(model.calibrations)))
    size = untouched.problem.whitening.size
    if plain.chi2 < GROSS_MISFIT.threshold * size:
        return None
    calibrated_search, calibration = calibrated(untouched)
    if calibration.error_sds.get(DISCREPANCY, 0.0) < UNTOUCHED_DISCREPANCY:
        return None
    search.report(f"first on the {count} frames in which nobody touches")
    _, _, after = run(calibrated_search)
    if replaces_instrument(after.effects):
        return None  # in noise of its own making it would explain anything
    is_explained = without_discrepancy(after, after.fit).chi2 / size < EXPLAINED
    if not (after.effects and is_explained):
        return None
    return StartingPoint.from_explanation(after)
