"""What is put aside before anything is looked at, and what it says of an effect."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ttest_1samp

from eitskin.data.recording import Recording, presses
from eitskin.data.subset import of_frames
from eitskin.diagnose import diagnosis
from eitskin.diagnose.fitting import readings
from eitskin.diagnose.fitting.fit import Fit, Problem, fit, rewhitened
from eitskin.diagnose.fitting.held_out import (
    MIN_PRESSES,
    HeldOut,
    draw_reserve_mask,
    error_units,
    predict_unseen,
    reciprocal_groups,
)
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.diagnose.search import prediction, pruning, refits, staging
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict import conclusion
from eitskin.physics.protocol import reciprocal_channels
from small_skin import CHANNELS, METADATA, candidates_of, problem_of, small_recording, states

CONTRAST = {"name": "touch-contrast", "parameters": {"ratio": 1.2}}
NOISE = 1e-3


def rows_aside(recorded, seed):
    """(N,): the frames that are put aside, whole."""
    kept = draw_reserve_mask(recorded, seed)
    assert kept.shape == recorded.voltage.shape
    rows = kept.any(axis=1)
    assert np.array_equal(kept, np.repeat(rows[:, None], kept.shape[1], axis=1))
    return rows


@given(st.integers(0, 1000), st.integers(MIN_PRESSES, 23))
def test_whole_presses_are_put_aside_with_the_frames_before_them(seed, places):
    frames = states(places, seed)
    recorded = Recording(frames, np.ones((len(frames), len(CHANNELS))), None, None, METADATA)
    touched, press = recorded.frames["touch"].to_numpy(bool), presses(recorded)
    rows = rows_aside(recorded, seed)
    chosen = np.unique(press[rows & touched])
    assert len(chosen) == max(1, round(places / 5))
    assert np.array_equal(rows[touched], np.isin(press, chosen)[touched])
    assert not rows[: np.flatnonzero(touched)[0]].any()
    for begin in np.flatnonzero(touched & ~np.r_[False, touched[:-1]])[1:]:
        assert rows[begin - 1] == rows[begin] and not touched[begin - 1]
    assert np.array_equal(rows, rows_aside(recorded, seed))


def test_other_seeds_put_other_presses_aside(make_recording):
    recorded = make_recording()
    found = {tuple(np.flatnonzero(rows_aside(recorded, seed))) for seed in range(8)}
    assert len(found) == 8
    # Nobody knows what followed the frames at the end: they go with the last press.
    rows, last = rows_aside(recorded, 0), presses(recorded).max()
    assert rows[-1] == rows[presses(recorded) == last].any()


@pytest.mark.parametrize("places", [0, MIN_PRESSES - 1])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_without_presses_reciprocal_channels_are_put_aside(make_recording, places, seed):
    recorded = make_recording(presses=places)
    kept = draw_reserve_mask(recorded, seed)
    columns = kept.any(axis=0)
    assert np.array_equal(kept, np.repeat(columns[None], len(kept), axis=0))
    for k, other in reciprocal_channels(recorded.channels)[0]:
        assert columns[k] == columns[other]
    assert 0.18 < columns.mean() < 0.22
    assert np.array_equal(kept, draw_reserve_mask(recorded, seed))
    assert not np.array_equal(kept, draw_reserve_mask(recorded, seed + 1))


def test_channels_tied_through_others_are_one_group():
    turned = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [0, 2, 1, 3]])
    group = reciprocal_groups(turned)
    assert group[0] == group[1] == group[2] != group[3]


def test_no_search_sees_what_is_put_aside():
    recorded = small_recording(noise=NOISE, places=5)
    noise, search, kept = staging.prepared(recorded, 3)
    assert np.array_equal(kept, draw_reserve_mask(recorded, 3)) and kept.any()
    assert np.array_equal(search.problem.whitening.mask, ~kept)
    assert np.isnan(search.problem.readings[kept]).all()
    # Nor does anything that it begins with depend on it.
    other = replace(recorded, voltage=np.where(kept, 1.003 * recorded.voltage, recorded.voltage))
    again, same, _ = staging.prepared(other, 3)
    assert np.array_equal(again.sd, noise.sd)
    assert refits.calibrated(search)[1].log_evidence == refits.calibrated(same)[1].log_evidence


@pytest.mark.parametrize("places", [1, 3])
def test_channels_put_aside_have_the_noise_of_their_level(places):
    """Where it grows with the reading; their own readings are not looked at."""
    recorded, share = small_recording(noise=0.0, places=places), 5e-3
    true = share * np.abs(recorded.voltage)
    recorded.voltage += true * np.random.default_rng(6).normal(size=true.shape)
    noise, search, kept = staging.prepared(recorded, 3)
    columns = kept.all(axis=0)
    assert columns.any() and np.array_equal(kept, np.repeat(columns[None], len(kept), axis=0))
    found = noise.sd / true[0]
    assert np.ptp(np.log(true[0, columns])) > 0.5
    assert np.allclose(found[columns], np.median(found[~columns]), rtol=0.1)
    search, state = refits.calibrated(search)
    there = readings.reserve_problem(search.problem, recorded, noise, kept)
    judged = Reserve(there, state.error_sds, search.converter_step, error_units(recorded))
    assert 0.7 < judged.noise_prediction(state.fit).chi2_per_dof < 1.4
    other = replace(recorded, voltage=np.where(kept, 1.3 * recorded.voltage, recorded.voltage))
    assert np.array_equal(staging.prepared(other, 3)[0].sd, noise.sd)


def searched(recorded, item):
    """A search of what is seen of a recording, a state with one effect, and what is put aside."""
    noise = NoiseModel(
        np.full(len(CHANNELS), NOISE * np.median(np.abs(recorded.voltage))), 1e6, "given"
    )
    kept = draw_reserve_mask(recorded, 1)
    seen = replace(recorded, voltage=np.where(kept, np.nan, recorded.voltage))
    problem, scales = readings.problem_of(seen, noise)
    candidates = candidates_of(seen, problem, scales)
    effect = next(c for c in candidates if c.name == item["name"])
    fold = np.arange(len(recorded.frames)) % 5
    search = Search(problem, [effect], fold, seed=1, report=print)
    state = refits.explain(search, fit(problem, [effect], np.zeros(2), polish=True))
    return search, state, noise, kept


def earning(search, state, there, recorded, noise):
    """What `pruning` leaves of a state, and the reserve that judged it."""

    def reserve_of(error_sds):
        return Reserve(there, error_sds, search.converter_step, error_units(recorded))

    return pruning._earning(search, state, reserve_of, noise.dof)


def harms(reserve, after, before, folds, accepted):
    """Whether the readings of the reserve and of folds are predicted plainly worse."""
    effect, less = SimpleNamespace(name="x", kind=None, sites=None), SimpleNamespace(effects=[])
    harm = reserve.harm(after, before, folds)
    return not pruning._is_harmless(Journal(), effect, less, harm, accepted)


@pytest.mark.parametrize("everywhere", [True, False])
def test_an_effect_that_only_seen_presses_have_is_not_earned(everywhere):
    recorded = small_recording(CONTRAST, noise=NOISE, places=6)
    plain = small_recording(noise=NOISE, places=6)
    kept = draw_reserve_mask(recorded, 1)
    if not everywhere:
        recorded.voltage = np.where(kept, plain.voltage, recorded.voltage)
    search, state, noise, kept = searched(recorded, CONTRAST)
    ratio = state.fit.settings()[0].values["ratio"]
    assert np.isclose(np.ravel(ratio)[0], 1.2, rtol=0.01)
    there = readings.reserve_problem(search.problem, recorded, noise, kept)
    left, judged = earning(search, state, there, recorded, noise)
    assert [c.name for c in left.effects] == (["touch-contrast"] if everywhere else [])
    assert [row["action"] for row in search.journal.steps] == ([] if everywhere else ["not earned"])
    gain, error = judged.gain(state.fit, refits.reduced(search, state, 0).fit)
    assert (gain > 2.0 * error) if everywhere else (gain < -2.0 * error)
    assert np.array_equal(judged.noise_whitening.mask, kept)


def test_harm_is_asked_of_predictions_as_each_fit_would_make_them(monkeypatch):
    """In another's covariance a fit would be another one: worse, maybe, than what does harm."""
    recorded = small_recording(CONTRAST, noise=NOISE, places=6)
    search, state, noise, kept = searched(recorded, CONTRAST)
    refits.linearised(
        search, refits.calibrated(search)[1]
    )  # what is met is kept in the covariance it was met in
    white = state.fit.problem.whitening
    other = replace(white, sd=white.sd * np.linspace(1.0, 30.0, len(white.sd)))
    problem = replace(state.fit.problem, whitening=other)
    state = replace(state, fit=rewhitened(state.fit, problem))
    there, asked = readings.reserve_problem(search.problem, recorded, noise, kept), []
    harmless = 1.0, 1.0, 0.0
    monkeypatch.setattr(Reserve, "harm", lambda self, *of: asked.append(of) or harmless)
    earning(search, state, there, recorded, noise)
    less, folds = refits.reduced(search, state, 0), asked[0][2]
    assert np.array_equal(folds[0].residual, state.held_out.residual)
    assert np.array_equal(folds[1].residual, less.held_out.residual)
    assert not np.allclose(folds[1].residual, prediction.predicted(search, less, state).residual)


@pytest.mark.parametrize(("gain_over_presses", "stays"), [(0.1, True), (-0.1, False)])
def test_a_gain_that_presses_do_not_have_in_common_is_not_earned(
    monkeypatch, gain_over_presses, stays
):
    recorded = small_recording(CONTRAST, noise=NOISE, places=6)
    search, state, noise, kept = searched(recorded, CONTRAST)
    there, asked = readings.reserve_problem(search.problem, recorded, noise, kept), []
    monkeypatch.setattr(
        Reserve, "gain_over_presses", lambda self, *of: asked.append(of) or gain_over_presses
    )
    left, _ = earning(search, state, there, recorded, noise)
    assert bool(left.effects) == stays
    after, before, folds = asked[0]
    assert after is state.fit and before is refits.reduced(search, state, 0).fit
    assert folds[0] is state.held_out


@pytest.fixture(scope="module")
def judging():
    """A toy: a fit whose residual in what is put aside is known, white and with rig errors."""
    recorded = small_recording(noise=NOISE, places=20)
    problem, _ = problem_of(recorded, NOISE)
    found = fit(problem, [], np.zeros(len(problem.model.calibrations)), polish=True)
    kept = draw_reserve_mask(recorded, 2)
    white = replace(problem.whitening, mask=kept, offset_ratio=np.zeros(len(CHANNELS)))
    return found, white, {"common-noise": 2.0 * white.sd.mean()}, error_units(recorded)


def judge(found, readings, white, sizes, unit):
    problem = Problem(found.problem.model, readings, white)
    return Reserve(problem, sizes, 0.0, unit)


def test_what_was_put_aside_is_judged_in_its_own_covariance(judging):
    found, white, sizes, unit = judging
    draw = np.random.default_rng(2)
    noise = white.sd * draw.normal(size=white.mask.shape)
    noise += 2.0 * white.sd.mean() * draw.choice([-1.0, 1.0], (len(noise), 1))
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    judged = judge(found, readings, white, sizes, unit)
    by, by_white = judged.prediction(found), judged.noise_prediction(found)
    assert np.isclose(by_white.chi2_per_dof, ((noise / white.sd)[white.mask] ** 2).mean())
    assert by_white.chi2_per_dof > 3.0 and 0.85 < by.chi2_per_dof < 1.15
    assert by.reading_count == white.mask.sum()
    assert np.isclose(by.rms, np.sqrt((noise[white.mask] ** 2).mean()))
    assert not by.error[~white.mask].any() and not by.residual[~white.mask].any()
    assert judged.p_value(found, 1e6) > 0.01
    assert judge(found, readings, white, {}, unit).p_value(found, 1e6) < 1e-6
    # A noise that nobody knows well is no ground to refuse a fit.
    assert judge(found, readings, white, {}, unit).p_value(found, 1.0) > 1e-3


@pytest.mark.parametrize("share", [0.0, 30.0])
def test_a_right_fit_is_seldom_refused(share):
    """Few frames, a value a channel fitted to them, and rig errors that are as large as they are
    said to be."""
    recorded = small_recording(noise=NOISE, places=20)
    problem, scales = problem_of(recorded, NOISE)
    chosen = [c for c in candidates_of(recorded, problem, scales) if c.name == "offset"]
    dense = next(c for c in chosen if c.scope == "dense")
    seen, kept = np.zeros((2, len(recorded.frames)), bool)
    seen[:6], kept[6:12] = True, True
    shape = recorded.voltage.shape
    plain = replace(problem.whitening, mask=np.broadcast_to(seen[:, None], shape))
    white = replace(problem.whitening, mask=np.broadcast_to(kept[:, None], shape).copy())
    assert np.ptp(white.sd) == 0.0
    sizes = {"common-noise": np.sqrt(share) * white.sd[0]}
    theta = np.zeros(len(problem.model.calibrations) + dense.size)
    there = problem.voltage(theta, [dense])
    found = fit(replace(problem, readings=there, whitening=plain), [dense], theta, polish=True)
    draw, p = np.random.default_rng(4), []
    for _ in range(150):
        error = found.root @ draw.normal(size=len(theta))
        off = np.tensordot(error, found.jacobian[:, 0] * problem.whitening.sd, 1)
        noise = white.sd * draw.normal(size=shape)
        noise += np.sqrt(share) * white.sd * draw.normal(size=(shape[0], 1))
        readings = np.where(white.mask, there + noise + off, np.nan)
        p.append(judge(found, readings, white, sizes, error_units(recorded)).p_value(found, 1e6))
    assert np.mean(np.array(p) < 0.05) < 0.1


def test_presses_of_unknown_force_are_not_put_aside(make_recording):
    recorded = make_recording(presses=8)
    press = presses(recorded)
    recorded.frames.loc[press >= 4, "force_N"] = np.nan
    for seed in range(6):
        rows = rows_aside(recorded, seed)
        assert (press[rows] >= 0).any() and press[rows].max() < 4


def test_a_gain_is_that_of_the_log_density(judging):
    found, white, sizes, unit = judging
    draw = np.random.default_rng(3)
    noise = white.sd * draw.normal(size=white.mask.shape)
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    judged = judge(found, readings, white, sizes, unit)
    off = Fit(found.problem, [], found.theta + 0.01, found.residual, found.slopes)
    gain, error = judged.gain(found, off)
    rigged = judged.transfer(found).problem.whitening
    here, there = (rigged(np.where(white.mask, readings - f.voltage(), 0.0)) for f in (found, off))
    assert np.isclose(gain, 0.5 * ((there**2).sum() - (here**2).sum()))
    assert np.isclose(error, np.linalg.norm(here - there))
    assert gain > 2.0 * error
    back, _ = judged.gain(off, found)
    assert np.isclose(back, -gain)


@pytest.mark.parametrize("common", [0.0, 30.0])
def test_what_predicts_plainly_worse_does_harm(judging, common):
    """Were the rig's errors ever so large: a covariance that excuses them is no excuse."""
    found, white, sizes, unit = judging
    noise = white.sd * np.random.default_rng(3).normal(size=white.mask.shape)
    noise += common * white.sd.mean() * np.random.default_rng(4).normal(size=(len(noise), 1))
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    judged = judge(found, readings, white, sizes, unit)
    off = Fit(found.problem, [], found.theta + 0.3, found.residual, found.slopes)
    plain = found.voltage() - off.voltage()
    here, there = (
        HeldOut(np.zeros(1), np.zeros(1), left, left, left.size) for left in (noise, noise + plain)
    )
    for believed in (False, True):
        assert harms(judged, off, found, (there, here), believed)
        assert not harms(judged, found, off, (here, there), believed)
        assert not harms(judged, found, found, (here, here), believed)


def test_a_little_harm_is_allowed_where_the_covariance_accepts_what_is_left(judging):
    found, white, sizes, unit = judging
    noise = white.sd * np.random.default_rng(3).normal(size=white.mask.shape)
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    judged = judge(found, readings, white, sizes, unit)
    here, little, much = (
        HeldOut(np.zeros(1), np.zeros(1), left, left, left.size)
        for left in (noise, 1.02 * noise, 1.2 * noise)
    )
    assert harms(judged, found, found, (little, here), False)
    assert not harms(judged, found, found, (little, here), True)
    assert harms(judged, found, found, (much, here), True)


def test_harm_to_one_press_alone_is_allowed_where_the_covariance_accepts_what_is_left(judging):
    found, white, sizes, unit = judging
    noise = white.sd * np.random.default_rng(3).normal(size=white.mask.shape)
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    judged = judge(found, readings, white, sizes, unit)
    here = HeldOut(np.zeros(1), np.zeros(1), noise, noise, noise.size)
    left = np.where(unit == unit[~white.mask].max(), 2.0, 1.0) * noise
    there = HeldOut(np.zeros(1), np.zeros(1), left, left, left.size)
    assert harms(judged, found, found, (there, here), False)
    assert not harms(judged, found, found, (there, here), True)


def test_one_unit_a_little_worse_is_no_harm(judging):
    found, white, sizes, unit = judging
    noise = white.sd * np.random.default_rng(3).normal(size=white.mask.shape)
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    here, there = (
        HeldOut(np.zeros(1), np.zeros(1), left, left, left.size) for left in (noise, 1.001 * noise)
    )
    judged = judge(found, readings, white, sizes, np.zeros_like(unit))
    for believed in (False, True):
        assert not harms(judged, found, found, (there, here), believed)


@pytest.mark.parametrize("gains", [(9.0, 9.0, 9.0), (40.0, 0.0, 0.0), (40.0, -12.0, -9.0)])
def test_a_gain_is_in_common_beyond_its_scatter_over_presses(judging, gains):
    """Student's t of the presses' own gains, times their scatter; 1 where one press gains alone."""
    found, white, sizes, unit = judging
    readings = np.where(white.mask, found.voltage(), np.nan)
    judged = judge(found, readings, white, sizes, unit)
    seen = replace(found.problem.whitening, mask=np.ones_like(white.mask))
    other = replace(found, problem=replace(found.problem, whitening=seen))
    label, frames = np.unique(unit[:, 0], return_counts=True)
    gain = np.resize(gains, len(label))
    density = (gain / frames)[np.searchsorted(label, unit[:, 0])]
    nothing = np.zeros_like(white.mask, float)
    here, there = (
        HeldOut(nothing[:, 0], found_density, nothing, nothing, nothing.size)
        for found_density in (density, np.zeros_like(density))
    )
    t = ttest_1samp(gain, 0.0).statistic
    told = judged.gain_over_presses(other, other, (here, there))
    assert np.isclose(told, gain.sum() - gain.sum() / t if np.ptp(gain) else gain.sum())
    assert (told < 0.0) == (t < 1.0)
    alone = np.where(np.arange(len(label)) == 3, 40.0, 0.0)
    alone = (alone / frames)[np.searchsorted(label, unit[:, 0])]
    assert (
        abs(judged.gain_over_presses(other, other, (replace(here, log_density=alone), there)))
        < 1e-6
    )
    one = judge(found, readings, white, sizes, np.zeros_like(unit))
    assert one.gain_over_presses(other, other, (here, there)) == np.inf
    # Presses that were put aside have a gain of their own.
    off = replace(other, theta=found.theta + 0.3)
    draw_reserve_mask = white.mask.any(axis=1)
    own = (
        np.where(
            draw_reserve_mask,
            judged.prediction(other).log_density - judged.prediction(off).log_density,
            0.0,
        )
        + density
    )
    total = np.array([own[unit[:, 0] == one].sum() for one in label])
    wanted = total.sum() * (1.0 - 1.0 / ttest_1samp(total, 0.0).statistic)
    assert np.isclose(judged.gain_over_presses(other, off, (here, there)), wanted)
    # Where nothing could be put aside these are the same readings, which count once.
    same = judge(found, found.voltage(), seen, sizes, unit)
    assert np.isclose(same.gain_over_presses(other, off, (here, there)), told)


def test_touches_of_unknown_force_are_no_presses_to_have_in_common():
    """Folds are of channels then."""
    gain = {"name": "drive-gain", "drives": [3], "parameters": {"gain": 1.05}}
    recorded = small_recording(gain, noise=NOISE, places=6)
    touched = recorded.frames["touch"].to_numpy(bool)
    recorded.frames.loc[touched, "force_N"] = np.nan
    found = diagnosis.diagnose(recorded)
    assert [effect.name for effect in found.explanation.effects] == ["drive-gain"]


def test_put_aside_leaves_out_what_was_lost(judging):
    found, white, _, _ = judging
    lost = white.mask & (np.random.default_rng(4).random(white.mask.shape) < 0.3)
    fewer = replace(white, mask=white.mask & ~lost)
    readings = np.where(fewer.mask, found.voltage() + white.sd, np.nan)
    told = predict_unseen(replace(found, problem=Problem(found.problem.model, readings, fewer)))
    assert told.reading_count == fewer.mask.sum()
    assert np.isclose(told.chi2.sum(), told.reading_count) and np.isclose(told.chi2_per_dof, 1.0)


@pytest.mark.long
def test_a_name_beside_much_that_has_none_is_a_candidate(monkeypatch):
    """What has no name opens the coordinates in the search's covariance; not when it is judged."""
    judged, p_value = [], Reserve.p_value
    monkeypatch.setattr(
        Reserve, "p_value", lambda self, fit, dof: judged.append(fit) or p_value(self, fit, dof)
    )
    gain = {"name": "measurement-gain", "measures": [4], "parameters": {"gain": 1.5}}
    every = small_recording(gain, noise=1e-4, places=2)
    recorded = of_frames(every, ~every.frames["touch"].to_numpy(bool))
    own = 1.0 + 0.01 * np.random.default_rng(5).normal(size=every.voltage.shape[1])
    recorded.voltage = own * recorded.voltage
    found = diagnosis.diagnose(recorded)
    assert found.explanation.error_sds["static-discrepancy"] > 0.0
    said = conclusion.document(found, "skin")
    assert len(judged) > 1 and all(fit.chi2 > 100.0 * found.explanation.fit.chi2 for fit in judged)
    assert said["effects"][0]["name"] == "measurement-gain"
    assert said["fit"]["held_out"]["chi2_per_dof_after"] > 100.0
    assert [effect["certain"] for effect in said["effects"]] == [False] * len(said["effects"])
    assert said["verdict"] == "partly-explained"
