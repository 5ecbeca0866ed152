"""Jacobians mapped into another covariance, and a fit's steps there, against differences."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.diagnose.fitting.fit import _slopes, derivative, fit, gauss_newton_step, rewhitened
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.noise.spectrum import Spectrum
from eitskin.diagnose.noise.whitening import ErrorColumns
from small_skin import CHANNELS, candidates_of, problem_of, small_recording

GAINS = {"name": "channel-gain", "parameters": {"gain": {"sd": 0.01}}}


@pytest.fixture
def mixed():
    """Two full columns and a block of channels of their own, as coordinates 1 and 3 to 5."""
    draw = np.random.default_rng(0)
    full = draw.normal(size=(6, 7, 4))
    coordinates, own = np.array([1, 3, 4, 5]), np.array([2, 0, 1, 3])
    full[coordinates] *= np.eye(4)[own][:, None, :]
    return Jacobian.from_full(full, [(coordinates, own)]), full


@pytest.mark.parametrize("by_channel", [True, False])
def test_mapped_columns_are_those_of_every_coordinate_mapped(mixed, by_channel):
    jacobian, full = mixed
    draw = np.random.default_rng(1)
    over_time, over_channels = draw.normal(size=(7, 7)), draw.normal(size=(4, 4))

    def of(columns):
        found = np.einsum("ij,kjm->kim", over_time, columns)
        return found if by_channel else found @ over_channels

    found = jacobian.mapped(of, by_channel)
    assert np.allclose(found.full(), of(full))
    assert len(found.blocks) == by_channel
    flat = of(full).reshape(6, -1)
    assert np.allclose(found.gram(), flat @ flat.T)
    assert np.allclose(jacobian.full(), full)


@pytest.fixture(scope="module")
def gains():
    """A fit of every channel's gain beside the calibrations, in white noise."""
    recorded = small_recording(GAINS, noise=1e-3, places=2)
    problem, scales = problem_of(recorded)
    candidates = candidates_of(recorded, problem, scales)
    effect = next(c for c in candidates if c.name == "channel-gain" and c.scope == "dense")
    return fit(problem, [effect], np.zeros(1 + effect.size), polish=True)


def rigged(problem, each):
    """The problem with errors that each channel, each frame, or all readings have."""
    draw = np.random.default_rng(2)
    sizes = {"channel": 0, "frame": 0, "whole": 0, each: 2}
    shape, sd = problem.readings.shape, problem.whitening.sd
    columns = {k: sd * draw.normal(size=(count, *shape)) for k, count in sizes.items()}
    whitening = replace(
        problem.whitening, spectrum=Spectrum((0.3,), (1.0,)), errors=ErrorColumns(**columns)
    )
    return replace(problem, whitening=whitening)


@pytest.mark.parametrize("each", ["channel", "frame", "whole"])
def test_slopes_whitened_anew_are_those_found_there(gains, each):
    there = rigged(gains.problem, each)
    found = rewhitened(gains, there)
    assert np.array_equal(found.residual, there.residual(gains.theta, gains.effects))
    assert found.theta is gains.theta and found.problem is there
    for index in (0, 1, 17, len(CHANNELS)):
        expected = derivative(there, gains.theta, gains.effects, found.residual, index)
        own = found.jacobian[index]
        assert np.linalg.norm(own - expected) < 1e-4 * np.linalg.norm(expected)
    afresh = _slopes(there, gains.theta, gains.effects, found.residual).full()
    assert np.allclose(found.jacobian, afresh, atol=1e-5 * np.abs(afresh).max())


def test_whitened_anew_there_and_back_is_the_same(gains):
    again = rewhitened(rewhitened(gains, rigged(gains.problem, "whole")), gains.problem)
    assert np.allclose(again.jacobian, gains.jacobian, atol=1e-9 * np.abs(gains.jacobian).max())
    assert np.isclose(again.chi2, gains.chi2)


def test_a_step_goes_to_the_optimum_there(gains):
    there = rewhitened(gains, rigged(gains.problem, "whole"))
    moved = gauss_newton_step(there)
    best = fit(there.problem, there.effects, there.theta, polish=True)
    assert best.cost <= moved.cost < there.cost
    assert moved.cost - best.cost < 0.02 * (there.cost - best.cost) + 0.02
    assert moved.slopes is there.slopes
    # At the optimum there is nowhere to go, and slopes that lead astray lead nowhere.
    assert gauss_newton_step(best).cost <= best.cost
    astray = replace(there, slopes=Jacobian(-there.jacobian))
    assert gauss_newton_step(astray) is astray
