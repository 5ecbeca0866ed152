"""What is put aside before anything is looked at, and folds of the rest, which decide."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ttest_1samp

from eitskin.data.recording import Recording, presses
from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting import readings
from eitskin.diagnose.fitting.fit import Problem, fit
from eitskin.diagnose.fitting.held_out import (
    MIN_PRESSES,
    HeldOut,
    draw_reserve_mask,
    folds,
    gain_over_presses,
    held_out,
    predict_unseen,
    reciprocal_groups,
)
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.noise.refinement import refine_noise
from eitskin.diagnose.search import refits, staging
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
    # Nor does anything that it begins with depend on it, outliers included.
    spiked = 1.003 * recorded.voltage
    loud = np.flatnonzero(kept.any(axis=1))[1]
    spiked[loud] *= 1.0 + 0.1 * np.random.default_rng(1).normal(size=kept.shape[1])
    other = replace(recorded, voltage=np.where(kept, spiked, recorded.voltage))
    simulated = refits.calibrated(search)[1].fit.voltage()
    assert loud in refine_noise(other, noise, simulated).loud_frames
    again, same, _ = staging.prepared(other, 3)
    assert np.array_equal(again.sd, noise.sd) and again.loud_frames == noise.loud_frames
    assert again.spike_count == noise.spike_count
    assert refits.calibrated(search)[1].log_evidence == refits.calibrated(same)[1].log_evidence


@pytest.mark.parametrize("places", [1, 3])
def test_channels_put_aside_have_the_noise_of_their_level(places):
    """Where it grows with the reading; their own readings are not looked at."""
    recorded, share = small_recording(noise=0.0, places=places), 5e-3
    true = share * np.abs(recorded.voltage)
    recorded.voltage += true * np.random.default_rng(6).normal(size=true.shape)
    noise, search, kept = staging.prepared(recorded, 3)
    problem = search.problem
    columns = kept.all(axis=0)
    assert columns.any() and np.array_equal(kept, np.repeat(columns[None], len(kept), axis=0))
    found = noise.sd / true[0]
    assert np.ptp(np.log(true[0, columns])) > 0.5
    assert np.allclose(found[columns], np.median(found[~columns]), rtol=0.1)
    search, state = refits.calibrated(search)
    there = readings.reserve_problem(problem, recorded, noise, kept)
    judged = Reserve(there, state.error_sds, search.converter_step)
    assert 0.7 < judged.noise_prediction(state.fit).chi2_per_dof < 1.4
    other = replace(recorded, voltage=np.where(kept, 1.3 * recorded.voltage, recorded.voltage))
    assert np.array_equal(staging.prepared(other, 3)[0].sd, noise.sd)


@pytest.fixture(scope="module")
def judging():
    """A toy: a fit whose residual in what is put aside is known, white and with rig errors."""
    recorded = small_recording(noise=NOISE, places=20)
    problem, _ = problem_of(recorded, NOISE)
    found = fit(problem, [], np.zeros(len(problem.model.calibrations)), polish=True)
    kept = draw_reserve_mask(recorded, 2)
    white = replace(problem.whitening, mask=kept, offset_ratio=np.zeros(len(CHANNELS)))
    return found, white, {"common-noise": 2.0 * white.sd.mean()}


def judge(found, readings, white, sizes):
    return Reserve(Problem(found.problem.model, readings, white), sizes, 0.0)


def test_what_was_put_aside_is_judged_in_its_own_covariance(judging):
    found, white, sizes = judging
    draw = np.random.default_rng(2)
    noise = white.sd * draw.normal(size=white.mask.shape)
    noise += 2.0 * white.sd.mean() * draw.choice([-1.0, 1.0], (len(noise), 1))
    readings = np.where(white.mask, found.voltage() + noise, np.nan)
    judged = judge(found, readings, white, sizes)
    by, by_white = judged.prediction(found), judged.noise_prediction(found)
    assert np.isclose(by_white.chi2_per_dof, ((noise / white.sd)[white.mask] ** 2).mean())
    assert by_white.chi2_per_dof > 3.0 and 0.85 < by.chi2_per_dof < 1.15
    assert by.reading_count == white.mask.sum()
    assert np.isclose(by.rms, np.sqrt((noise[white.mask] ** 2).mean()))
    assert not by.error[~white.mask].any() and not by.residual[~white.mask].any()
    without = judge(found, readings, white, {}).prediction(found)
    assert np.isclose(without.chi2_per_dof, by_white.chi2_per_dof)


def with_noise(found, draw):
    """A fit to the readings that another fit expects, with its noise."""
    problem = found.problem
    noise = problem.whitening.sd * draw.normal(size=problem.readings.shape)
    readings = np.where(problem.whitening.mask, found.voltage() + noise, np.nan)
    problem = replace(problem, readings=readings)
    return fit(problem, found.effects, found.theta, found.jacobian, polish=True)


@pytest.mark.parametrize(
    ("places", "names"), [(0, {"drive-gain"}), (1, set()), (6, {"drive-gain", "offset"})]
)
def test_a_right_fit_is_seldom_refused(places, names):
    """By channels, stretches of time or presses; also with a value at every site, which with the
    conductivity are not determined."""
    recorded = small_recording(noise=NOISE, places=max(places, 1))
    if not places:
        recorded = of_frames(recorded, ~recorded.frames["touch"].to_numpy(bool))
    problem, scales = problem_of(recorded, NOISE)
    white = replace(problem.whitening, offset_ratio=np.zeros(len(CHANNELS)))
    problem = replace(problem, whitening=white)
    model = problem.model
    dense = [
        c
        for c in candidates_of(recorded, problem, scales)
        if c.name in names and c.scope == "dense" and c.kind != "channels"
    ]
    assert {c.name for c in dense} == names
    size = len(model.calibrations) + sum(c.size for c in dense)
    found = fit(problem, dense, np.zeros(size), polish=True)
    fold, draw = folds(model.touched, model.press, recorded.channels, 1), np.random.default_rng(3)
    p = np.array([held_out(with_noise(found, draw), fold).p_value(1e9) for _ in range(80)])
    assert (p < 0.01).mean() <= 0.035 and (p < 0.1).mean() < 0.18
    assert 0.35 < (p < 0.5).mean() < 0.65 and (p > 0.95).mean() < 0.12


def test_a_wrong_fit_is_refused_unless_nobody_knows_the_noise():
    recorded = small_recording(CONTRAST, noise=NOISE, places=6)
    problem, _ = problem_of(recorded, NOISE)
    model = problem.model
    found = fit(problem, [], np.zeros(len(model.calibrations)), polish=True)
    fold = folds(model.touched, model.press, recorded.channels, 1)
    assert held_out(found, fold).p_value(1e6) < 1e-6
    assert held_out(found, fold).p_value(1.0) > 1e-3


def test_presses_of_unknown_force_are_not_put_aside(make_recording):
    recorded = make_recording(presses=8)
    press = presses(recorded)
    recorded.frames.loc[press >= 4, "force_N"] = np.nan
    for seed in range(6):
        rows = rows_aside(recorded, seed)
        assert (press[rows] >= 0).any() and press[rows].max() < 4


@pytest.mark.parametrize("gains", [(9.0, 9.0, 9.0), (40.0, 0.0, 0.0), (40.0, -12.0, -9.0)])
def test_a_gain_is_in_common_beyond_its_scatter_over_presses(gains):
    """Student's t of the presses' own gains, times their scatter; 1 where one press gains alone."""
    press = np.repeat(np.arange(20), 5)
    pressed = np.arange(100) % 5 > 0
    nothing = np.zeros((100, 1))

    def densities(density):
        return HeldOut(nothing[:, 0], density, nothing, nothing, 100)

    gain, there = np.resize(gains, 20).astype(float), densities(nothing[:, 0])
    told = gain_over_presses(densities(gain[press] / 5.0), there, press, pressed)
    t = ttest_1samp(gain, 0.0).statistic if np.ptp(gain) else np.inf
    assert np.isclose(told, gain.sum() - gain.sum() / t)
    assert (told < 0.0) == (t < 1.0)
    alone = densities(np.where(press == 3, 8.0, 0.0))
    assert abs(gain_over_presses(alone, there, press, pressed)) < 1e-6
    assert gain_over_presses(alone, there, np.zeros(100, int), pressed) == np.inf
    # Untouched frames, or touches of unknown state, are no press.
    assert gain_over_presses(alone, there, press, pressed & (press == 3)) == np.inf


def test_put_aside_leaves_out_what_was_lost(judging):
    found, white, _ = judging
    lost = white.mask & (np.random.default_rng(4).random(white.mask.shape) < 0.3)
    fewer = replace(white, mask=white.mask & ~lost)
    readings = np.where(fewer.mask, found.voltage() + white.sd, np.nan)
    told = predict_unseen(replace(found, problem=Problem(found.problem.model, readings, fewer)))
    assert told.reading_count == fewer.mask.sum()
    assert np.isclose(told.chi2.sum(), told.reading_count) and np.isclose(told.chi2_per_dof, 1.0)
