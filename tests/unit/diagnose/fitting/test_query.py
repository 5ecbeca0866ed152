"""Predictions are the fit's own: of a query of the recording's states what the fit has for them."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.diagnose.fitting.fit import Fit
from eitskin.diagnose.fitting.held_out import draw_reserve_mask
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.fitting.query import simulator
from eitskin.diagnose.fitting.readings import noise_and_problem
from small_skin import small_recording

RECORDINGS = 20  # of every form


def of_unknown_scale(recorded, draw):
    """The recording in a unit of its own."""
    return replace(
        recorded,
        voltage=recorded.voltage * 10.0 ** draw.uniform(-6.0, 6.0),
        metadata=recorded.metadata | {"unit": "arbitrary"},
    )


def of_unknown_current(recorded, draw):
    """The recording, in volts at a current that nobody knows, as differences."""
    untouched = recorded.voltage[~recorded.frames["touch"].to_numpy(bool)].mean(axis=0)
    skin = recorded.metadata["skin"] | {"current_A": None}
    return replace(
        recorded,
        voltage=(recorded.voltage - untouched) * 10.0 ** draw.uniform(-2.0, 2.0),
        metadata=recorded.metadata | {"skin": skin, "values": "difference"},
    )


def in_robot_frame(recorded, draw):
    """The recording in a unit of its own, its places in the robot's coordinates."""
    place = recorded.frames["x_mm"].to_numpy() + 1j * recorded.frames["y_mm"].to_numpy()
    place = np.exp(1j * draw.uniform(0.0, 2.0 * np.pi)) * place + complex(*draw.normal(0, 300, 2))
    scaled = of_unknown_scale(recorded, draw)
    return replace(
        scaled,
        frames=recorded.frames.assign(x_mm=place.real, y_mm=place.imag),
        metadata=scaled.metadata | {"position_frame": "robot"},
    )


@pytest.mark.parametrize("form", [of_unknown_scale, of_unknown_current, in_robot_frame])
def test_a_query_has_the_scale_and_the_frame_of_the_fit(form):
    """Of the readings that were fitted a reserve was no part: of all of them they start
    elsewhere."""
    for seed in range(RECORDINGS):
        draw = np.random.default_rng([seed, 5])
        recorded = form(small_recording(seed=seed, places=5), draw)
        reserve_mask = draw_reserve_mask(recorded, seed)
        _, problem, _ = noise_and_problem(recorded, reserve_mask)
        theta = 0.1 * draw.normal(size=len(problem.model.calibrations))
        no_slopes = Jacobian(np.empty((0, *problem.readings.shape)))
        fitted = Fit(problem, [], theta, np.zeros(problem.readings.shape), no_slopes)
        voltage = simulator(fitted, recorded, replace(recorded, voltage=None))(theta)
        expected = problem.model.voltage(theta, [])
        assert np.abs(voltage - expected).max() < 1e-12 * np.abs(expected).max()
