"""Where touches truly were, found from what they read."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.diagnose.fitting import touches
from eitskin.diagnose.fitting.fit import Problem
from eitskin.diagnose.fitting.linearisation import linearised_rig_errors
from small_skin import calibrated, problem_of, small_recording

NOISE = 3e-4
PLACES = {"place-per-frame": 1.0}


def strayed(off_mm, noise=NOISE):
    """A problem whose touches are by off_mm (N, 2) beside where they are said to be."""
    recorded = small_recording(noise=noise, places=8)
    told = recorded.frames.copy()
    touched = told["touch"].to_numpy(bool)
    for column, off in zip(("x_mm", "y_mm"), np.moveaxis(off_mm(len(told)), 1, 0), strict=True):
        told.loc[touched, column] -= off[touched]
    problem, _ = problem_of(replace(recorded, frames=told), noise)
    return problem, off_mm(len(told)) * touched[:, None]


def by(size):
    """Normal strays of a size in mm."""
    return lambda frames: size * np.random.default_rng(5).normal(size=(frames, 2))


def found(problem, sizes):
    fitted = calibrated(problem)
    rig = linearised_rig_errors(fitted, problem.whitening, 0.0)
    return fitted, touches.relocated_touches(problem, fitted, rig, sizes)


def test_touches_are_found_where_they_were():
    problem, truth = strayed(by(0.8))
    fitted, model = found(problem, PLACES)
    off = touches.displacements(model, problem.model)
    left = np.column_stack([off["x_mm"], off["y_mm"]]) - truth
    touched = problem.model.touched
    assert np.sqrt((left[touched] ** 2).mean()) < 0.15 * np.sqrt((truth[touched] ** 2).mean())
    assert not left[~touched].any() and not off["force_N"].any()

    def misfit(there):
        voltage = replace(problem, model=there).voltage(fitted.theta, [])
        return np.sqrt((((problem.readings - voltage) / problem.whitening.sd) ** 2).mean())

    assert misfit(problem.model) > 3.0 * misfit(model)


def test_they_are_followed_no_farther_than_their_errors_reach():
    problem, truth = strayed(by(0.8))
    _, model = found(problem, {"place-per-frame": 0.2})
    off = touches.displacements(model, problem.model)
    assert max(np.abs(off[key]).max() for key in off) <= 0.2 * touches.MAX_DISPLACEMENT_SDS + 1e-9
    assert np.abs(truth).max() > 0.2 * touches.MAX_DISPLACEMENT_SDS


@pytest.mark.parametrize(
    ("off_mm", "sizes"),
    [(0.0, PLACES), (0.03, PLACES), (0.8, {}), (0.8, {"place-per-frame": 0.05})],
)
def test_readings_that_follow_in_proportion_are_left_as_they_are(off_mm, sizes):
    problem, _ = strayed(by(off_mm), noise=1e-4)
    _, model = found(problem, sizes)
    assert model is problem.model


def test_readings_that_are_put_aside_move_nothing():
    problem, _ = strayed(by(0.8))
    mask = problem.whitening.mask.copy()
    mask[::2] = False
    recorded = np.where(mask, problem.readings, np.nan)
    fewer = Problem(problem.model, recorded, replace(problem.whitening, mask=mask))
    _, model = found(fewer, PLACES)
    off = touches.displacements(model, problem.model)
    assert not off["x_mm"][::2].any() and off["x_mm"][1::2].any()


def test_a_second_time_nothing_moves():
    problem, _ = strayed(by(0.8))
    fitted, model = found(problem, PLACES)
    there = replace(fitted, problem=replace(problem, model=model))
    rig = linearised_rig_errors(there, problem.whitening, 0.0)
    assert touches.relocated_touches(problem, there, rig, PLACES) is model
