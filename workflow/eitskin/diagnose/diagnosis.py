"""A recording diagnosed, from noise and calibration to search and remainder."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from eitskin.data.check import naming
from eitskin.data.recording import Recording, voltages
from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.candidates import Scales, catalogue
from eitskin.diagnose.fitting.channel_mapping import carried, unknown
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB, excerpt
from eitskin.diagnose.fitting.fit import Fit, Problem, difference, fit, whitened_anew
from eitskin.diagnose.fitting.held_out import aside, folds, units
from eitskin.diagnose.fitting.memory import most_frames
from eitskin.diagnose.fitting.reserve import Judged
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.noise.estimate import Noise, estimate
from eitskin.diagnose.noise.rig import Rig
from eitskin.diagnose.noise.rig_sizes import findings
from eitskin.diagnose.noise.steadiness import refine
from eitskin.diagnose.noise.whitening import COHERENT, Whitening
from eitskin.diagnose.search.fitting import GROSS, STANDARD_ERRORS, UNEXPLAINED
from eitskin.diagnose.search.resorts import foreign
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.start import Start
from eitskin.diagnose.search.state import State
from eitskin.diagnose.verdict.atlas import atlas
from eitskin.diagnose.verdict.gaps import Gap, gaps, strengths
from eitskin.diagnose.verdict.remainder import Other, other, unlike
from eitskin.diagnose.verdict.rivals import Rival, rivals
from eitskin.diagnose.verdict.verdict import acceptable
from eitskin.effects.effect import Setting
from eitskin.effects.settings import site_counts
from eitskin.errors import InputError
from eitskin.physics import outline
from eitskin.physics.accuracy import untouched_error
from eitskin.physics.geometry import Geometry

FIRST_FRAMES = 120  # on which the search begins, where there are twice as many
FIRST_SHARE = 2 / 3  # of what may be solved, that the search on these may take
# Of the median |v|: error of a body that is solved at accuracy train, in most channels; it is where
# the noise of a frame's mean is so many times as much, and nobody touches.
BODY, COARSE = 1e-4, 3.0
# Where so much of the readings in untouched frames is left, these few at least are diagnosed
# first, for this share of what may be solved.
BARE, LEAST_BARE, BARE_SHARE = 3e-3, 5, 1 / 3
EXPLAINED = 2.0  # chi squared a degree of freedom, up to which these begin the search on all
FORCES = np.linspace(1.0, 0.0, 11)  # of a query's largest, up to which predictions are tried
WHERE = {"drives": "drive", "measures": "measuring pair", "channels": "channel"}


@dataclass(frozen=True)
class Diagnosis:
    """What was found of one recording, and the search that found it. aside (N, M): readings that
    the search has not seen; judged: by which it is judged; rig: its errors, as of `findings`;
    named: the fit of the state after, nothing without a name in its covariance. parts, steps: of a
    recording that was diagnosed apart, as diagnosis.json has them; the part that is `told` is what
    this is of, and has its frames alone.
    """

    recorded: Recording
    search: Search
    noise: Noise
    before: State
    after: State
    aside: np.ndarray
    judged: Judged
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
    recorded: Recording,
    seed: int = 1,
    progress: bool = False,
    memory_GiB: float = LIMIT_GIB,
    earlier: list[Setting] | None = None,
) -> Diagnosis:
    """Diagnose a recording: locate, name and model what its simulation leaves out.

    Of a long recording, an excerpt, as long as memory_GiB are foretold to allow; a search on a few
    frames of it is where that on all begins, or the effects of an earlier diagnosis, as of
    `start.read`, where these explain it: each has to be borne out. Equal seeds and earlier effects
    give equal results, bit for bit. Raises InputError where nothing can be simulated, and where it
    would take more memory.
    """
    # Shared out among cores, small products take longer, and their sums are of other bytes.
    with threadpool_limits(1, user_api="blas"):
        return _diagnosed(recorded, seed, progress, memory_GiB, earlier)


def _diagnosed(
    recorded: Recording,
    seed: int,
    progress: bool,
    memory_GiB: float,
    earlier: list[Setting] | None,
) -> Diagnosis:
    voltages(recorded, "recording")
    outline.refuse(recorded.skin, "recording")

    def report(line: str) -> None:
        if progress:
            print(f"  {line}", file=sys.stderr, flush=True)

    whole = len(recorded.frames)
    recorded = excerpt(recorded, most_frames(recorded, memory_GiB))
    if len(recorded.frames) < whole:
        report(f"an excerpt: {len(recorded.frames)} of {whole} frames")
    noise, search, kept = begun(recorded, seed, report)
    there = search.problem.whitening.mask
    seen = replace(recorded, voltage=np.where(there, recorded.readings, np.nan))
    begun_with = search.problem
    put_aside = _put_aside(begun_with, recorded, noise, kept)
    cut_short = False
    known = _earlier(search, earlier, report) if earlier else None
    if known is not None:
        before, after = search.grown(*known)
    else:
        start = _untouched_first(search, seen, seed, report)
        calibrated: State | None = None
        if len(recorded.frames) >= 2 * FIRST_FRAMES:
            few = partial(_few_first, search, seen, seed, report, start)
            both: list[Callable[[], tuple]] = [few, lambda: (search.calibrated(), search.rig)]
            (start, cut_short), (calibrated, search.rig) = search.apart(lambda of: of(), both)
            report(f"then on {len(recorded.frames)}")
        before, after = search.run(start, calibrated)
    after, judged = _kept_effects(search, before, after, put_aside, recorded, noise)
    search.renew_catalogue_p(after)
    if not after.effects:
        before = after
    rig = Rig.about(after.fit, search.problem.whitening, noise.step)
    report("comparing with every other name")
    found = [gaps(search, after, i) for i in range(len(after.effects))]
    if search.spent or cut_short:
        search.cut_short(after)
    named = _named(search, after, begun_with.whitening)
    atlas_after = _atlas(recorded, noise, named)
    left = _left(search, after, atlas_after)
    return Diagnosis(
        recorded,
        search,
        noise,
        before,
        after,
        kept,
        judged,
        findings(rig, after.sizes, after.fit.misfit, recorded.metadata["unit"], noise),
        _atlas(recorded, noise, _named(search, before, begun_with.whitening)),
        atlas_after,
        named,
        found,
        strengths(search, after),
        left,
    )


def begun(
    recorded: Recording, seed: int, report: Callable[[str], None] = lambda line: None
) -> tuple[Noise, Search, np.ndarray]:
    """The noise of a recording; the search of its whole catalogue, which has not run yet; and the
    readings (N, M) that are put aside before anything is looked at. InputError where nothing can be
    simulated."""
    kept = aside(recorded, seed)
    seen = replace(recorded, voltage=np.where(kept, np.nan, recorded.readings))
    first = estimate(seen)
    problem, scales = problem_of(seen, first)
    model = problem.model
    noise, problem = _steadied(recorded, seen, first, problem)
    report(f"noise {np.median(noise.sd):.3g} ({noise.source})")
    candidates = catalogue(
        recorded.skin,
        model.believed,
        np.where(problem.whitening.mask, recorded.readings, np.nan),
        site_counts(recorded.channels),
        scales,
        floating=not model.sink_grounded,
        timed=recorded.metadata["clock"] == "measured",
        touched=bool(model.touched.any()),
    )
    return (
        noise,
        _search(problem, candidates, recorded.channels, seed, report, noise.step),
        kept,
    )


def _steadied(
    recorded: Recording, seen: Recording, first: Noise, problem: Problem
) -> tuple[Noise, Problem]:
    """The noise as the residuals of calibrations alone show it, in what is seen of a recording;
    and the problem with it; first: the noise by the recording alone. Channels of which nothing is
    seen have that of their simulated level. Loud frames and spikes are found in the whole
    recording."""
    model = problem.model
    there = fit(problem, [], np.zeros(len(model.calibrations)), polish=True).voltage()
    simulated = np.where(model.known[:, None], there, np.nan)
    if not (model.difference or model.touched.all()):
        unseen = np.isnan(seen.readings).all(axis=0)
        first = first.told_of(unseen, np.abs(there[~model.touched].mean(axis=0)))
    noise = refine(seen, first, simulated)
    whole = refine(recorded, first, simulated)
    noise = replace(noise, lost=whole.lost, loud_frames=whole.loud_frames, spikes=whole.spikes)
    return noise, problem_of(seen, noise, model)[0]


def _search(
    problem: Problem,
    candidates: list,
    channels: np.ndarray,
    seed: int,
    report: Callable[[str], None],
    converter_step: float,
    share: float = 1.0,
) -> Search:
    model = problem.model
    fold = folds(model.touched & model.known, model.press, channels, seed)
    ordinary = [c for c in candidates if not c.effect.last_resort]
    resorts = [c for c in candidates if c.effect.last_resort]
    return Search(
        problem,
        ordinary,
        fold,
        share,
        rigged=True,
        converter_step=converter_step,
        seed=seed,
        report=report,
        resorts=resorts,
    )


def problem_of(
    recorded: Recording, noise: Noise, model: RecordingSimulator | None = None
) -> tuple[Problem, Scales]:
    """The fitting problem of a recording whose noise is known, and the sizes of its readings;
    model: its simulator, where there is one."""
    model = model or RecordingSimulator(recorded)
    readings = _readings(recorded, noise, model)
    if not np.isfinite(readings).any():
        found = f"{int(model.touched.sum())} touches of unknown force or probe and no other frame"
        raise InputError("recording", "frames", found, "untouched frames, or touches fully known")
    if not np.nan_to_num(readings).any():
        raise InputError("recording", "column voltage_V", "0 in every frame", "readings of a skin")
    median = float(np.nanmedian(np.abs(readings[~model.touched])) or 0.0)
    if model.difference or not np.isfinite(median):
        median = float(np.nanmedian(np.abs(readings)))
    share = float(np.median(noise.sd)) / np.sqrt(len(readings)) / (median or 1.0)
    model.coarse = not model.touched.any() and share > COARSE * BODY
    geometry = Geometry.from_skin(model.believed)
    current = model.believed.current_A if model.unit != "ohm" else 1.0
    assert current is not None
    error = np.abs(current * untouched_error(geometry, recorded.channels, "diagnose"))
    coherent = BODY if model.coarse else COHERENT
    error = np.hypot(error, np.hypot(coherent * median, noise.rounding))
    whitening = Whitening.of(readings, noise.sd, model.difference, error)
    clock = recorded.frames["frame"].to_numpy()
    whitening = replace(whitening, correlation=noise.correlation, clock=clock)
    return Problem(model, readings, whitening), Scales(median / model.factor, current)


def _readings(recorded: Recording, noise: Noise, model: RecordingSimulator) -> np.ndarray:
    """(N, M): what can be compared with a simulation, NaN where a touch's state is not known or a
    reading is lost."""
    lost = np.zeros(recorded.readings.shape, bool) if noise.lost is None else noise.lost
    return np.where(model.known[:, None] & ~lost, recorded.readings, np.nan)


def _left(search: Search, after: State, left: pd.DataFrame) -> Other:
    """What is said of what a state leaves, `left` in the atlas."""
    if search.unlike(after):
        return unlike(search.likeness(after))
    return other(left, search.catalogue_p)


def _kept_effects(
    search: Search,
    before: State,
    after: State,
    put_aside: Problem,
    recorded: Recording,
    noise: Noise,
) -> tuple[State, Judged]:
    """What a search ended with, less what does not earn its place; where that was a last resort,
    the state before it, judged in the noise before it."""
    was_foreign = foreign(after.effects)
    after, judged = _earned(search, search.settled(after), put_aside, recorded, noise)
    if was_foreign and not foreign(after.effects):
        search.unblur()
        after, judged = _earned(search, before, put_aside, recorded, noise)
    return after, judged


def _earned(
    search: Search, state: State, put_aside: Problem, recorded: Recording, noise: Noise
) -> tuple[State, Judged]:
    """A state less the effects that do not earn their place: on folds of what the search saw by two
    standard errors; on readings that were put aside one value by any gain, many of their own by two
    standard errors; on both by more than the gain scatters over presses. It must not do harm
    either, as of `Judged.harms`: less is allowed where the misfit of what was put aside is more
    than its covariance allows."""
    while True:
        judged = Judged(put_aside, state.sizes, search.converter_step, units(recorded))
        believed = acceptable(judged.p_value(search.named(state, state.fit), noise.dof))
        weakest, least = None, 0.0
        for index, effect in enumerate(state.effects):
            less = search.less(state, index)
            gain, error = judged.gain(state.fit, less.fit)
            free = STANDARD_ERRORS * error if effect.scope == "dense" else 0.0
            folds = state.held_out, search.held_out(less, state)
            folds_gain, folds_error = folds[0].gain(folds[1])
            in_common = judged.in_common(state.fit, less.fit, folds)
            worth = min(gain - free, folds_gain - STANDARD_ERRORS * folds_error, in_common)
            # Each as it would predict, in a covariance of its own: another one moves its fit.
            own = state.held_out, less.held_out
            if judged.harms(state.fit, less.fit, own, believed):
                worth = -np.inf
            if worth < least:
                weakest, least = index, worth
        if weakest is None:
            return state, judged
        search.step("not earned", state.effects[weakest], state)
        state = search.less(state, weakest)


def _put_aside(problem: Problem, recorded: Recording, noise: Noise, kept: np.ndarray) -> Problem:
    """What was put aside, readings (N, M), with the noise of what is seen; that itself, where
    nothing could be put aside."""
    readings = np.where(kept, _readings(recorded, noise, problem.model), np.nan)
    white = replace(problem.whitening, mask=np.isfinite(readings))
    if white.size <= 0:
        return problem
    return replace(problem, recorded=readings, whitening=white)


def _on_frames(
    search: Search,
    recorded: Recording,
    few: Recording,
    seed: int,
    report: Callable[[str], None],
    share: float,
) -> Search:
    """A search like one of a recording, on a few of its frames."""
    problem = search.problem
    model = RecordingSimulator(recorded, few, problem.model.near)
    readings = np.where(model.known[:, None], few.readings, np.nan)
    clock = few.frames["frame"].to_numpy()
    whitening = replace(problem.whitening, mask=np.isfinite(readings), clock=clock)
    problem = Problem(model, readings, whitening)
    candidates = [*search.candidates, *search.resorts]
    return _search(
        problem, candidates, recorded.channels, seed, report, search.converter_step, share
    )


def _earlier(
    search: Search, earlier: list[Setting], report: Callable[[str], None]
) -> tuple[State, State] | None:
    """The state before, and one of what was found earlier; None, and a line of it, where that does
    not explain the recording: far from its optimum a search would go astray from there."""
    names = ", ".join(one.effect.name for one in earlier)
    report(f"first what was found earlier: {names}")
    start = Start.at(earlier, search.candidates, search.problem)
    if start is None:
        report("not all of it is sought in this recording; begun anew")
        return None
    before = search.calibrated()
    begun = search.begun(before, start)
    size = search.problem.whitening.size
    if begun is None or search.named(begun, begun.fit).chi2 > EXPLAINED * size:
        report("it does not explain this recording; begun anew")
        return None
    return before, begun


def _few_first(
    search: Search,
    recorded: Recording,
    seed: int,
    report: Callable[[str], None],
    start: Start | None,
) -> tuple[Start, bool]:
    """What FIRST_FRAMES frames show, from a start, and whether the search on them was cut short."""
    few = excerpt(recorded, FIRST_FRAMES)
    report(f"first on {len(few.frames)} frames")
    first = _on_frames(search, recorded, few, seed, report, FIRST_SHARE)
    return Start.of(first.run(start)[1]), first.spent


def _untouched_first(
    search: Search, recorded: Recording, seed: int, report: Callable[[str], None]
) -> Start | None:
    """What explains the frames in which nobody touches, where more than BARE of their readings is
    left unexplained: so far off, touches would be followed to anywhere. None where nothing does:
    a wrong name would stay."""
    model = search.problem.model
    count = int((~model.touched).sum())
    if model.difference or count < LEAST_BARE or not model.touched.any():
        return None
    few = of_frames(recorded, ~model.touched)
    first = _on_frames(search, recorded, few, seed, report, BARE_SHARE)
    plain = fit(first.problem, [], np.zeros(len(model.calibrations)))
    if plain.chi2 < GROSS * first.problem.whitening.size:
        return None
    if first.calibrated().sizes.get(UNEXPLAINED, 0.0) < BARE:
        return None
    report(f"first on the {count} frames in which nobody touches")
    start = first.run()[1]
    if foreign(start.effects):
        return None  # in noise of its own making it would explain anything
    left = first.named(start, start.fit).chi2 / first.problem.whitening.size
    return Start.of(start) if start.effects and left < EXPLAINED else None


def _named(search: Search, state: State, white: Whitening) -> Fit:
    """A state's fit as it is where nothing without a name is in its covariance; white: of the
    recording's own noise, which is all that such a covariance has beside another instrument."""
    if foreign(state.effects):
        return whitened_anew(state.fit, replace(state.fit.problem, whitening=white))
    named = search.named(state, state.fit)
    if named is state.fit:
        return named
    return fit(named.problem, named.effects, named.theta, named.jacobian, polish=True)


def _atlas(recorded: Recording, noise: Noise, fit: Fit) -> pd.DataFrame:
    simulated = np.where(fit.problem.whitening.mask, fit.voltage(), np.nan)
    fitted = fit.jacobian.reshape(len(fit.theta), -1).T
    residual = np.where(fit.problem.whitening.mask, fit.residual, np.nan)
    return atlas(recorded, residual, simulated / noise.sd, fitted)


def predict(
    found: Diagnosis, query: Recording, state: State | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Voltages (N, M) of a query's states by its own channels, noise-free, and their standard
    deviations; by another state than the one found, where that is given. InputError for touches of
    unknown state.

    Where the laws found have no physics at a force, as they may beyond the forces that they were
    found at, touches are predicted as at the largest one at which they have: a line on stderr says
    so. So does one of channels at whose drive or pair an effect could not be found: they are
    predicted without it, as uncertain as its sites differ.
    """
    fit, force = (state or found.after).fit, query.frames["force_N"].to_numpy(float)
    strange = _strange(fit, found.recorded, query)
    refused: InputError | None = None
    for most in np.nanmax(force, initial=0.0) * FORCES:
        lighter = query.frames.assign(force_N=np.minimum(force, most))
        voltage = simulator(fit, found.recorded, replace(query, frames=lighter))
        try:
            there = voltage(fit.theta)
            moved = [difference(voltage, fit.theta, there, i) for i in range(len(fit.theta))]
            unlike = [voltage(fit.theta, index) - there for index in strange]
        except InputError as error:
            refused = refused or error
            continue
        if refused:
            said = f"touches above {most:.3g} N are predicted as at {most:.3g} N: {refused}"
            print(f"  {said}", file=sys.stderr, flush=True)
        slopes = np.array(moved).reshape(len(fit.theta), *there.shape)
        spread = np.einsum("pq,pnm->qnm", fit.root, slopes)
        return there, np.sqrt((spread**2).sum(axis=0) + sum(one**2 for one in unlike))
    assert refused is not None
    raise refused


def _strange(fit: Fit, recorded: Recording, query: Recording) -> list[int]:
    """The effects of a recording's fit that some of a query's channels are predicted without; a
    line on stderr each says of which."""
    found = []
    for index, setting in enumerate(fit.settings()):
        rows = unknown(setting, recorded.channels, query.channels)
        if len(rows):
            found.append(index)
            assert setting.kind is not None
            them = naming.channels(query, rows)
            said = f"{setting.effect.name}: {them} of the query are predicted without it, for the"
            said += f" recording has no such {WHERE[setting.kind]}; std_V has its spread"
            print(f"  {said}", file=sys.stderr, flush=True)
    return found


def simulator(fit: Fit, recorded: Recording, query: Recording) -> Callable[..., np.ndarray]:
    """Voltages (N, M) of a query's states by its channels, noise-free, of the coordinates (P,) of a
    recording's fit; `strange`: the index of an effect that sites which the recording does not have
    differ in by its spread, else not at all. InputError for touches of unknown state."""
    problem = Problem(RecordingSimulator(recorded, query), np.zeros(1), fit.problem.whitening)
    if not problem.model.known.all():
        row = int(np.flatnonzero(~problem.model.known)[0])
        raise InputError("query", f"row {row}", "a touch of unknown state", "x, y, force and probe")

    def voltage(theta: np.ndarray, strange: int | None = None) -> np.ndarray:
        knobs, chosen = problem.split(theta, fit.effects)
        chosen = [
            carried(setting, recorded.channels, query.channels, float(index == strange))
            for index, setting in enumerate(chosen)
        ]
        return problem.model.voltage(knobs, chosen)

    return voltage
