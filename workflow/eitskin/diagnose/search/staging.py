"""Where a search begins: whole, on few frames, on untouched frames, or from stated effects."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from eitskin.data.averages import LEAST_FRAMES
from eitskin.data.recording import Recording
from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.candidates import Candidate, replaces_instrument
from eitskin.diagnose.fitting.excerpt import excerpt_mask
from eitskin.diagnose.fitting.families import members, most_frames
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.held_out import draw_reserve_mask, folds
from eitskin.diagnose.fitting.memory import MIN_FRAMES
from eitskin.diagnose.fitting.readings import noise_and_problem
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search.catalogue import Conditions, catalogue
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.families import (
    among_calibrations,
    with_members,
    without_members,
    without_members_as_candidates,
)
from eitskin.diagnose.search.gates import GROSS_MISFIT
from eitskin.diagnose.search.growth import Outcome, at_start, calibration_start, grown, run
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.prediction import is_unlike
from eitskin.diagnose.search.refits import (
    DISCREPANCY,
    calibrated,
    forked,
    settled,
    without_discrepancy,
)
from eitskin.diagnose.search.search import Cache, Search
from eitskin.diagnose.search.starting_point import StartingPoint
from eitskin.effects.effect import Setting
from eitskin.effects.settings import site_counts

FIRST_FRAMES = 120  # on which the search begins, where there are twice as many
FIRST_SHARE = 2 / 3  # of the budget, that the search on these may take
# Where more than this share of the untouched readings is left unexplained, untouched frames are
# searched first, if there are so many of them, for this share of the budget.
UNTOUCHED_DISCREPANCY, LEAST_UNTOUCHED, UNTOUCHED_SHARE = 3e-3, 5, 1 / 3
AVERAGES = 6  # of frames that nobody touches: what is wrong in all of them is in these
MOST_DENSE_NAMES = 1  # with values at every site: with two, a skin is a little wrong everywhere
EXPLAINED = 2.0  # chi squared a reading, up to which such a start is trusted


class FewerFrames(Exception):
    """A recording is a little wrong at every site, and has more frames than families are fitted to;
    frames: to how many they are; are_averages: of successive frames, else an excerpt."""

    def __init__(self, frames: int, are_averages: bool) -> None:
        super().__init__(f"families are fitted to {frames} frames")
        self.frames = frames
        self.are_averages = are_averages


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
    if not (conditions.touched or model.difference):
        search = _with_families(search)
    return noise, search, reserve_mask


def _folds(problem: Problem, channels: np.ndarray, seed: int) -> np.ndarray:
    model = problem.model
    return folds(model.touched & model.simulable, model.press, channels, seed)


def searched(
    recording: Recording, search: Search, seed: int, stated: list[Setting] | None = None
) -> tuple[Outcome, bool]:
    """The outcome of a search of a recording, begun where it is cheapest, and whether a stage of it
    was cut short; stated: effects with which it begins where these explain the recording. Raises
    FewerFrames where averages or an excerpt are to be searched in its place."""
    _refuse_many_untouched(search)
    stated_start = _at_stated(search, stated) if stated else None
    if stated_start is not None:
        return grown(*stated_start), False
    mask = search.problem.whitening.mask
    fitted = replace(recording, voltage=np.where(mask, recording.readings, np.nan))
    untouched = _untouched_first(search, fitted, seed)
    if untouched is None:
        return _on_all(search, fitted, seed, None)
    with_families, start = among_calibrations(search, untouched)
    if with_families is search:
        return _on_all(search, fitted, seed, start)
    _, baseline = calibrated(search, start.theta[: len(search.problem.model.calibrations)])
    (search, _, best), was_cut_short = _on_all(with_families, fitted, seed, start)
    baseline = without_members(baseline, search.problem.model, search.rig)
    return (search, baseline, best), was_cut_short


def _on_all(
    search: Search, recording: Recording, seed: int, start: StartingPoint | None
) -> tuple[Outcome, bool]:
    """The outcome of a search of all frames of a recording from a start, begun on FIRST_FRAMES of
    many, and whether that was cut short."""
    if len(recording.frames) < 2 * FIRST_FRAMES:
        return run(search, start), False
    stages: list[Callable[[], tuple]] = [
        partial(_few_first, search, recording, seed, start),
        partial(_calibrated_rig, search, start),
    ]
    (start, was_cut_short), (calibration, rig) = forked(search, lambda stage: stage(), stages)
    search = replace(search, rig=rig)
    search.report(f"then on {len(recording.frames)}")
    return run(search, start, calibration), was_cut_short


def _calibrated_rig(search: Search, start: StartingPoint | None) -> tuple:
    """The calibrated explanation, and the rig's errors about it."""
    search, calibration = calibrated(search, calibration_start(search, start))
    return calibration, search.rig


def _on_frames(
    search: Search, recording: Recording, rows: np.ndarray, seed: int, share: float
) -> Search:
    """A search like that of a recording, on some of its frames: rows (N,) bool."""
    problem, part = search.problem, of_frames(recording, rows)
    model = RecordingSimulator(part, problem.model, problem.model.solved_skins)
    model = model.with_families_of(problem.model, rows)
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
    rows = excerpt_mask(recording, FIRST_FRAMES)
    search.report(f"first on {rows.sum()} frames")
    on_few = _on_frames(search, recording, rows, seed, FIRST_SHARE)
    on_few, _, after = run(on_few, start)
    return StartingPoint.from_explanation(after), on_few.spent


def _untouched_first(search: Search, recording: Recording, seed: int) -> Explanation | None:
    """The effects and families that explain the frames in which nobody touches, where more than
    UNTOUCHED_DISCREPANCY of their readings is unexplained: so far off, touches would be followed to
    anywhere. None where nothing does: a wrong name would stay."""
    model = search.problem.model
    count = int((~model.touched).sum())
    if model.difference or count < LEAST_UNTOUCHED or not model.touched.any():
        return None
    untouched = _on_frames(search, recording, ~model.touched, seed, UNTOUCHED_SHARE)
    start = _misfit(untouched)
    if start is None:
        return None
    calibrated_search, calibration = start
    search.report(f"first on the {count} frames in which nobody touches")
    _, _, named = run(calibrated_search)
    if replaces_instrument(named.effects):
        return None  # in noise of its own making it would explain anything
    by_names = named if named.effects and _explains(named) and _is_touchable(named) else None
    dense_names = {effect.name for effect in named.effects if effect.scope == "dense"}
    if by_names is not None and len(dense_names) <= MOST_DENSE_NAMES:
        return by_names
    if is_unlike(calibrated_search, calibration):
        return by_names
    fewer = _fewer_frames(search, touched=True)
    if fewer is not None:
        raise fewer
    if not _takes_families(search, touched=True):
        return by_names
    used_share = untouched.budget_used * untouched.budget_share
    with_families = _with_families(replace(untouched, budget_share=used_share + UNTOUCHED_SHARE))
    ended, calibration, best = run(with_families)
    settled_search, best = settled(ended, best)
    _, _, after = with_members((settled_search, calibration, best))
    if not (_explains(after) and _is_touchable(after)):
        if by_names is not None:
            return by_names
        # Families alone are no wrong name.
        settled_search, unnamed = settled(ended, calibration)
        _, _, after = with_members((settled_search, calibration, unnamed))
    return after if after.fit.problem.model.families or _explains(after) else None


def _misfit(search: Search) -> tuple[Search, Explanation] | None:
    """The calibrated search of untouched frames, and its explanation, where more than
    UNTOUCHED_DISCREPANCY of their readings is unexplained; else None."""
    problem = search.problem
    plain = fit(problem, [], np.zeros(len(problem.model.calibrations)))
    if plain.chi2 < GROSS_MISFIT.threshold * problem.whitening.size:
        return None
    calibrated_search, calibration = calibrated(search)
    if calibration.error_sds.get(DISCREPANCY, 0.0) < UNTOUCHED_DISCREPANCY:
        return None
    return calibrated_search, calibration


def _takes_families(search: Search, touched: bool) -> bool:
    """Whether a catalogue has families, and a recording no more frames than these are fitted to."""
    return len(search.problem.readings) <= _family_frames(search, touched)


def _refuse_many_untouched(search: Search) -> None:
    """Raise FewerFrames where nobody touches, averages or an excerpt are less, and the misfit is
    that of a skin that is a little wrong at every site."""
    model = search.problem.model
    if model.touched.any() or model.difference:
        return
    fewer = _fewer_frames(search, touched=False)
    problem = replace(search.problem, families={})
    if fewer is not None and _misfit(replace(search, problem=problem, cache=Cache())):
        raise fewer


def _fewer_frames(search: Search, touched: bool) -> FewerFrames | None:
    """What is to be searched in place of a recording that is a little wrong at every site, where
    that is less: averages, or an excerpt of as many frames as families are fitted to. A converter's
    steps would be hidden in averages."""
    limit, count = _family_frames(search, touched), len(search.problem.readings)
    has_averages = count >= LEAST_FRAMES * AVERAGES and not (touched or search.converter_step)
    if limit and has_averages:
        return FewerFrames(AVERAGES, are_averages=True)
    if MIN_FRAMES <= limit < count:
        return FewerFrames(limit, are_averages=False)
    return None


def _family_frames(search: Search, touched: bool) -> int:
    """The number of frames to which the families of a catalogue are fitted; 0 where it has none."""
    families = search.problem.families or members(search.candidates)
    channels = search.problem.readings.shape[1]
    return most_frames(families, channels, touched) if families else 0


def _explains(explanation: Explanation) -> bool:
    """Whether an explanation leaves little more than noise, without a discrepancy."""
    plain = without_discrepancy(explanation, explanation.fit)
    return plain.chi2 < EXPLAINED * plain.problem.whitening.size


def _is_touchable(explanation: Explanation) -> bool:
    """Whether touches can be simulated beside the effects of an explanation: of patches no more
    than one."""
    return sum(c.effect.disc for c in explanation.effects) < 2


def _with_families(search: Search) -> Search:
    """A search of frames that nobody touches, with families in place of the candidates that are
    their members, where there are no more frames than these are fitted to."""
    if not _takes_families(search, touched=False):
        return search
    families = members(search.candidates)
    problem, cache = replace(search.problem, families=families), replace(search.cache, lacks={})
    search = replace(search, problem=problem, cache=cache)
    every_member = (member for family in families.values() for member in family)
    return without_members_as_candidates(search, every_member)
