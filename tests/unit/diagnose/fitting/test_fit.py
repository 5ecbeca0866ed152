"""Fits against what was planted, intervals by their coverage, held-out frames against refits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares

from eitskin.data.recording import presses
from eitskin.diagnose.fitting import fit as diagnose_fit
from eitskin.diagnose.fitting.estimates import calibration, estimates
from eitskin.diagnose.fitting.fit import (
    OPTIMUM_TOLERANCE,
    Fit,
    FitLimits,
    derivative,
    fit,
    gauss_newton_step,
    inverse_root,
    rewhitened,
)
from eitskin.diagnose.fitting.held_out import FOLDS, folds, held_out
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.noise.spectrum import Spectrum
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.physics.protocol import reciprocal_channels
from small_skin import CHANNELS, METADATA, calibrated, candidates_of, problem_of, small_recording

DRAWS = 40
PLANTED = [
    {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.6}},
    {"name": "touch-contrast", "parameters": {"ratio": 1.1}},
    {"name": "measurement-gain", "measures": [5], "parameters": {"gain": 1.02}},
]


def chosen_of(candidates, items):
    """The candidates with the items' names and sites."""
    found = []
    for item in items:
        sites = next((tuple(v) for k, v in item.items() if k.endswith("s") and k[0] in "edm"), None)
        found.append(next(c for c in candidates if c.name == item["name"] and c.sites == sites))
    return found


@pytest.fixture(scope="module")
def planted():
    """A noise-free recording of three effects, its problem and the effects' candidates."""
    recorded = small_recording(*PLANTED, noise=0.0, places=4)
    problem, scales = problem_of(recorded)
    return problem, chosen_of(candidates_of(recorded, problem, scales), PLANTED)


def test_a_fit_finds_what_was_planted(planted):
    problem, effects = planted
    found = fit(problem, effects, np.zeros(1 + 3), polish=True)
    assert found.chi2 < OPTIMUM_TOLERANCE
    values = [s.values[next(iter(s.values))] for s in found.settings()]
    assert np.allclose([np.ravel(v)[0] for v in values], [1.6, 1.1, 1.02], rtol=1e-3)
    assert np.isclose(calibration(found)["conductivity_S_per_m"]["value"], 0.5, rtol=1e-3)


def test_intervals_cover_what_was_planted(planted):
    problem, effects = planted
    start = fit(problem, effects, np.zeros(4), polish=True)
    draw = np.random.default_rng(5)
    truth, covered = [1.6, 1.1, 1.02], np.zeros((DRAWS, 3), bool)
    for k in range(DRAWS):
        noise = problem.whitening.sd * draw.normal(size=problem.readings.shape)
        noisy = replace(problem, readings=problem.readings + noise)
        found = fit(noisy, effects, start.theta, start.jacobian)
        assert abs(found.chi2 - noise.size) < 6 * np.sqrt(2 * noise.size)
        for i, value in enumerate(truth):
            (estimate,) = estimates(found, i).values()
            assert estimate["low"] < estimate["value"] < estimate["high"]
            covered[k, i] = estimate["low"] <= value <= estimate["high"]
    assert 0.8 <= covered.mean() <= 0.98
    assert (covered.mean(axis=0) >= 0.7).all()


def test_a_fit_that_cannot_be_good_enough_is_given_up(planted):
    problem, _ = planted
    here = problem.residual(np.zeros(1), [])
    found = fit(problem, [], np.zeros(1), limits=FitLimits(0.0))
    assert found.chi2 == (here**2).sum()


def test_a_fit_that_its_rounds_alone_end_says_so(planted, monkeypatch):
    problem, effects = planted
    assert fit(problem, effects, np.zeros(4)).converged
    monkeypatch.setattr(diagnose_fit, "MAX_ITERATIONS", 1)
    assert not fit(problem, effects, np.zeros(4)).converged


def test_a_step_that_promises_little_is_not_taken(planted):
    problem, effects = planted
    start = fit(problem, effects, np.zeros(4), polish=True)
    moved = problem.residual(start.theta + 1e-3, effects)
    near = Fit(problem, effects, start.theta + 1e-3, moved, start.slopes)
    promised = near.cost - gauss_newton_step(near).cost
    assert promised > 0.0 and gauss_newton_step(near, 0.5 * promised) is not near
    assert gauss_newton_step(near, 2.0 * promised) is near


def test_a_fit_is_itself_in_its_own_covariance(planted):
    problem, effects = planted
    found = fit(problem, effects, np.zeros(4))
    assert rewhitened(found, replace(problem)) is found
    other = replace(problem, whitening=replace(problem.whitening))
    assert rewhitened(found, other) is not found


def test_intervals_are_those_of_the_covariance(planted):
    problem, effects = planted
    found = fit(problem, effects, np.zeros(4), polish=True)
    spread = np.sqrt(np.diag(found.covariance)[1:])
    scale = [c.scales.typical_change(next(iter(c.effect.parameters.values()))) for c in effects]
    for i, candidate in enumerate(effects):
        (estimate,) = estimates(found, i).values()
        half = NORMAL_90 * scale[i] * spread[i]
        parameter = next(iter(candidate.effect.parameters.values()))
        low, value, high = (estimate[key] for key in ("low", "value", "high"))
        if parameter.low > 0:
            assert np.isclose(np.log(high / value), half, rtol=1e-3)
            assert np.isclose(np.log(value / low), half, rtol=1e-3)
        else:
            assert np.isclose(high - value, half, rtol=1e-3)
            assert np.isclose(value - low, half, rtol=1e-3)


def test_an_unknown_size_is_calibrated():
    recorded = small_recording(noise=0.0, places=3)
    skin = recorded.metadata["skin"] | {"contrast_per_N": None, "contact_impedivity_ohm_m2": None}
    recorded.metadata = recorded.metadata | {"skin": skin}
    problem, _ = problem_of(recorded, noise=1e-4)
    found = calibration(calibrated(problem))
    assert np.isclose(found["contrast_per_N"]["value"], 0.5, rtol=1e-2)
    assert np.isclose(found["contact_impedivity_ohm_m2"]["value"], 2e-3, rtol=1e-2)
    assert found["contrast_per_N"]["unit"] == "1/N"


def linear(seed, frames, channels, size):
    """A problem whose readings are linear in its coordinates, fitted."""
    draw = np.random.default_rng(seed)
    slopes = draw.normal(size=(size, frames, channels))
    recorded = np.tensordot(draw.normal(size=size), slopes, 1) + draw.normal(
        size=(frames, channels)
    )
    problem = SimpleNamespace(
        residual=lambda theta, effects: recorded - np.tensordot(theta, slopes, 1),
        model=SimpleNamespace(calibrations=[None] * size),
        whitening=Whitening(
            np.ones((frames, channels), bool), np.full(channels, 3.0), np.zeros(channels)
        ),
    )
    flat = slopes.reshape(size, -1)
    theta = np.linalg.solve(flat @ flat.T + np.eye(size), flat @ recorded.ravel())
    residual = recorded - np.tensordot(theta, slopes, 1)
    return Fit(problem, [], theta, residual, Jacobian(slopes)), recorded


@given(arrays(float, 4, elements=st.floats(-6.0, 6.0)), st.integers(0, 2**32 - 1))
def test_a_root_is_that_of_the_inverse_whatever_the_units(powers, seed):
    slopes = np.random.default_rng(seed).normal(size=(4, 40)) * 10.0 ** powers[:, None]
    precision = slopes @ slopes.T
    root = inverse_root(precision)
    units = np.sqrt(np.diag(precision))
    got = (root @ root.T) * np.outer(units, units)
    assert np.allclose(got, np.linalg.inv(precision / np.outer(units, units)), rtol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_known_far_better_than_the_rest_has_a_covariance_with_a_root(seed):
    """Of the inverse, rounded, half of these have no Cholesky factor."""
    known = np.random.default_rng(seed).normal(size=6)
    root = inverse_root(1e10 * np.outer(known, known) + np.eye(6))
    exact = np.eye(6) - np.outer(known, known) / (known @ known + 1e-10)
    assert np.allclose(root @ root.T, exact, atol=1e-4)


def test_a_precision_that_rounding_left_not_positive_has_a_root():
    rounded = np.array([[1.0, 1.0 + 1e-15], [1.0 + 1e-15, 1.0]])
    assert np.linalg.eigvalsh(rounded)[0] < 0.0
    root = inverse_root(rounded)
    assert np.isfinite(root).all()
    assert np.isclose(np.ones(2) @ root @ root.T @ np.ones(2), 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_held_out_frames_are_those_of_refits(seed):
    found, recorded = linear(seed, frames=12, channels=5, size=4)
    fold = np.random.default_rng(seed).permutation(12) % 3
    by_formula = held_out(found, fold)
    density = np.zeros(12)
    for row in range(12):
        seen = fold != fold[row]
        flat = found.jacobian[:, seen].reshape(4, -1)
        information = flat @ flat.T + np.eye(4)
        theta = np.linalg.solve(information, flat @ recorded[seen].ravel())
        own = found.jacobian[:, row]
        error = recorded[row] - theta @ own
        assert np.allclose(by_formula.error[row], error)
        assert np.isclose(by_formula.chi2[row], error @ error)
        covariance = np.eye(5) + own.T @ np.linalg.solve(information, own)
        _, log_size = np.linalg.slogdet(covariance)
        density[row] = -0.5 * (error @ np.linalg.solve(covariance, error) + log_size)
    assert np.allclose(by_formula.log_density, density)
    assert by_formula.reading_count == 60
    assert by_formula.rms == pytest.approx(3.0 * np.sqrt(by_formula.chi2.sum() / 60))
    other = replace(by_formula, log_density=density - 1.0, error=by_formula.error + 0.5)
    assert by_formula.gain(other) == pytest.approx((12.0, 0.5 * np.sqrt(60)))


def test_what_a_fold_leaves_is_undone_from_its_own_refit():
    """Noise that lasts shares a frame with the next, which another fold may have left out."""
    found, recorded = linear(1, frames=12, channels=5, size=4)
    fold = np.arange(12) % 3
    whitening = replace(found.problem.whitening, sd=np.ones(5), spectrum=Spectrum((0.9,), (1.0,)))
    slopes = Jacobian(whitening(found.jacobian))
    found.problem.residual = lambda theta, effects: whitening(
        recorded - np.tensordot(theta, found.jacobian, 1)
    )
    found.problem.whitening = whitening
    lasting = Fit(found.problem, [], found.theta, whitening(found.residual), slopes)
    plain = held_out(lasting, fold).residual
    for one in range(3):
        seen = fold != one
        flat = slopes.full(seen).reshape(4, -1)
        information = flat @ flat.T + np.eye(4)
        theta = np.linalg.solve(information, flat @ whitening(recorded)[seen].ravel())
        error = recorded - np.tensordot(theta, found.jacobian, 1)
        assert np.allclose(plain[~seen], error[~seen])


def test_magnitudes_are_expected_as_noise_leaves_them():
    metadata = {**METADATA, "voltage": "magnitude"}
    recorded = replace(small_recording(noise=0.0, places=1), metadata=metadata)
    problem, _ = problem_of(recorded)
    signed = problem.model.voltage(np.zeros(1), [])
    sd = np.full(signed.shape[1], np.abs(signed).max())
    problem = replace(problem, whitening=replace(problem.whitening, sd=sd))
    noise = sd * np.random.default_rng(1).normal(size=(20_000, *signed[:2].shape))
    read = np.abs(np.abs(signed[:2]) + noise).mean(axis=0)
    expected = problem.voltage(np.zeros(1), [])[:2]
    assert np.allclose(expected, read, rtol=0.03)
    assert not np.allclose(expected, np.abs(signed[:2]), rtol=0.1)


@pytest.mark.parametrize("ratio", [4.0, 30.0])
def test_held_out_frames_are_refits_where_readings_do_not_follow_in_proportion(ratio):
    item = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": ratio}}
    recorded = small_recording(item, noise=0.05, places=4)
    problem, scales = problem_of(recorded, 0.05)
    effects = chosen_of(candidates_of(recorded, problem, scales), [item])
    found = fit(problem, effects, np.zeros(2), polish=True)
    fold = np.arange(len(recorded.frames)) % 2  # half of the readings out
    by_folds = held_out(found, fold)

    def of(theta, seen):
        return np.r_[problem.residual(theta, effects)[seen].ravel(), np.sqrt(found.prior) * theta]

    for one in (0, 1):
        refit = least_squares(of, found.theta, args=(fold != one,), xtol=1e-12, ftol=1e-12)
        error = problem.residual(refit.x, effects)[fold == one]
        from_seen = np.linalg.norm(found.residual[fold == one] - error)
        assert np.linalg.norm(by_folds.error[fold == one] - error) < 0.35 * from_seen


def test_folds_keep_presses_whole():
    recorded = small_recording(places=7)
    touched, press = recorded.frames["touch"].to_numpy(), presses(recorded)
    channels = recorded.channels
    fold = folds(touched, press, channels, 1)
    assert set(fold) == set(range(FOLDS))
    for k in range(7):
        assert len(set(fold[press == k])) == 1
    before = np.flatnonzero(touched[1:] & ~touched[:-1])[1:]
    assert (fold[before] == fold[before + 1]).all()
    assert (folds(touched, press, channels, 1) == fold).all()
    assert (folds(touched, press, channels, 2) != fold).any()


def test_folds_of_a_single_press_are_stretches():
    fold = folds(np.ones(20, bool), np.zeros(20, int), CHANNELS, 1)
    assert (np.diff(fold) >= 0).all() and np.bincount(fold).tolist() == [4] * FOLDS


def test_folds_without_a_touch_are_of_channels():
    fold = folds(np.zeros(20, bool), np.full(20, -1), CHANNELS, 1)
    assert fold.shape == (1, len(CHANNELS)) and set(fold[0]) == set(range(FOLDS))
    pairs = reciprocal_channels(CHANNELS)[0]
    assert all(fold[0][k] == fold[0][other] for k, other in pairs)


def test_held_out_channels_have_an_error_in_volts():
    whole = small_recording(places=2)
    recorded = replace(whole, frames=whole.frames[:4], voltage=whole.voltage[:4])
    found = calibrated(problem_of(recorded)[0])
    fold = folds(found.problem.model.touched, found.problem.model.press, CHANNELS, 1)
    left = held_out(found, fold)
    assert left.chi2_per_dof == pytest.approx(1.0, abs=0.3)
    noise = np.sqrt((found.problem.whitening.sd**2).mean())
    assert left.rms == pytest.approx(noise, rel=0.3)


@pytest.mark.parametrize("beside", ["touch-contrast", "crosstalk", "multiplexer-memory"])
@pytest.mark.parametrize("name", ["channel-gain", "measurement-gain", "drive-gain", "offset"])
def test_jacobians_are_those_of_single_steps(name, beside):
    """Also where sites are moved together, which they only may be as long as nothing mixes them."""
    recorded = small_recording(places=2)
    problem, scales = problem_of(recorded)
    candidates = candidates_of(recorded, problem, scales)
    dense = next(c for c in candidates if c.name == name and c.scope == "dense")
    effects = [next(c for c in candidates if c.name == beside), dense]
    theta = 0.3 * np.random.default_rng(1).normal(size=1 + sum(c.size for c in effects))
    residual = problem.residual(theta, effects)
    jacobian = fit(problem, effects, theta, limits=FitLimits(-np.inf)).jacobian
    for i in (0, 1, 2, len(theta) // 2, len(theta) - 1):
        single = derivative(problem, theta, effects, residual, i)
        assert np.abs(jacobian[i] - single).max() < 1e-6 * np.abs(single).max()
