import copy

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eitskin.data import alignment, importers
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from shared_data import shared_data


def test_readings_of_a_homogeneous_disc_fall_away_from_the_drive_and_are_reciprocal():
    reading = alignment.homogeneous_readings(channel_table(16), even_angles(16))
    table = {
        tuple(row): value for row, value in zip(channel_table(16).tolist(), reading, strict=True)
    }
    first_channels = [table[0, 1, j, j + 1] for j in range(2, 9)]
    assert all(value < 0 for value in first_channels), "potentials rise from the sink to the source"
    assert np.all(np.diff(np.abs(first_channels)) < 0)
    for (source, sink, plus, minus), value in table.items():
        assert table[plus, minus, source, sink] == pytest.approx(value, rel=1e-12)


def test_driven_electrodes_have_no_finite_reading_as_points():
    channels = np.array([[0, 1, 1, 2], [0, 1, 2, 3]])
    reading = alignment.homogeneous_readings(channels, even_angles(16))
    assert np.isnan(reading[0]) and np.isfinite(reading[1])


def test_sensitivity_summed_over_an_inner_disc_is_the_closed_form():
    """Of two rim points, theta apart, grad N . grad N over |x| < rho sums to
    -ln(1 - 2 rho^2 cos theta + rho^4) / 2 pi (from the Fourier series of N).
    """
    channels, angles, rho, n = channel_table(16), even_angles(16), 0.8, 256
    nodes, weights = np.polynomial.legendre.leggauss(24)
    radius, weights = rho * (nodes + 1.0) / 2.0, rho * weights / 2.0
    turn = np.exp(2j * np.pi * np.arange(n) / n)
    summed = np.zeros(len(channels))
    for r, weight in zip(radius, weights, strict=True):
        summed += weight * r * alignment.sensitivity(channels, angles, r * turn).mean(axis=0)
    angle = np.deg2rad(angles[:, None] - angles[None, :])
    pair = -np.log(1.0 - 2.0 * rho**2 * np.cos(angle) + rho**4) / (2.0 * np.pi)
    source, sink, plus, minus = channels.T
    expected = pair[plus, source] - pair[plus, sink] - pair[minus, source] + pair[minus, sink]
    np.testing.assert_allclose(2.0 * np.pi * summed, -expected, rtol=1e-10)


def move_frame(recording, scale, turn_deg, shift, mirrored):
    """The same recording in a robot's frame, from which the similarity leads back."""
    robot = copy.deepcopy(recording)
    skin = recording.frames["x_mm"].to_numpy() + 1j * recording.frames["y_mm"].to_numpy()
    place = (skin - shift) / (scale * np.exp(1j * np.deg2rad(turn_deg)))
    place = np.conj(place) if mirrored else place
    robot.frames["x_mm"], robot.frames["y_mm"] = place.real, place.imag
    robot.metadata["position_frame"] = "robot"
    return robot


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    scale=st.floats(0.5, 2.0),
    turn_deg=st.floats(-179.0, 179.0),
    shift=st.complex_numbers(max_magnitude=300.0),
    is_mirrored=st.booleans(),
    seed=st.integers(0, 3),
)
def test_a_similarity_is_found_again(make_recording, scale, turn_deg, shift, is_mirrored, seed):
    recording = make_recording(seed=seed)
    if seed % 2:
        recording.voltage = np.abs(recording.voltage)
        recording.metadata["voltage"] = "magnitude"
    robot = move_frame(recording, scale, turn_deg, shift, is_mirrored)
    similarity = alignment.fit(robot)
    assert similarity.is_mirrored == is_mirrored
    assert similarity.scale == pytest.approx(scale, rel=0.02)
    angle_error = (similarity.rotation_deg - turn_deg + 180.0) % 360.0 - 180.0
    assert abs(angle_error) < 1.0
    touch = recording.frames["touch"].to_numpy()
    skin_places = similarity(robot.frames["x_mm"][touch], robot.frames["y_mm"][touch])
    skin = recording.frames.loc[touch, ["x_mm", "y_mm"]].to_numpy().T
    assert np.hypot(*(skin_places - skin)).max() < 2.5
    assert similarity.rival_residual > 5 * similarity.residual


def test_without_a_radius_the_unit_is_the_radius(make_recording):
    recording = make_recording()
    recording.metadata["skin"]["radius_mm"] = None
    similarity = alignment.fit(move_frame(recording, 1.0, 30.0, 5.0, False))
    assert 1.0 / similarity.scale == pytest.approx(80.0, rel=0.02)


def test_lost_readings_do_not_move_the_hotspots_far(make_recording):
    recording = make_recording()
    recording.voltage[:, ::5] = np.nan
    rows = alignment.strongest_touches(recording)
    spots = 80.0 * alignment.hotspots(recording, rows)
    places = recording.frames[["x_mm", "y_mm"]].to_numpy()[rows] @ np.array([1, 1j])
    assert np.median(np.abs(spots - places)) < 3.0


def test_the_strongest_touches_are_chosen_by_force_else_by_change(make_recording):
    recording = make_recording(presses=80)
    rows = alignment.strongest_touches(recording)
    assert len(rows) == alignment.MAX_TOUCHES
    assert recording.frames["force_N"][rows[:80]].eq(8.0).all()
    recording.frames.loc[recording.frames["touch"], "force_N"] = np.nan
    assert len(alignment.strongest_touches(recording)) == alignment.MAX_TOUCHES


def test_what_cannot_be_aligned_is_refused(make_recording):
    weak = make_recording(presses=4)
    weak.frames["force_N"] *= 0.09
    with pytest.raises(InputError, match="found 0 strong ones"):
        alignment.fit(weak)
    nowhere = make_recording(presses=1)
    with pytest.raises(InputError, match="found all at one place"):
        alignment.fit(nowhere)
    unknown = make_recording()
    unknown.metadata["skin"]["electrode_deg"] = None
    with pytest.raises(InputError, match="electrode_deg"):
        alignment.fit(unknown)
    query = make_recording()
    query.voltage = None
    with pytest.raises(InputError, match="query"):
        alignment.fit(query)


def test_touches_on_a_real_hydrogel_skin_tell_its_handedness():
    recording = importers.load(shared_data("hydrogel-skin/ohmc16.mat"))
    straight = alignment.fit(recording)
    assert not straight.is_mirrored and straight.scale == pytest.approx(1.0, abs=0.05)
    assert straight.residual < 10.0 and straight.rival_residual > 40.0
    robot = move_frame(recording, 0.8, 130.0, 20.0 + 400.0j, True)
    turned = alignment.fit(robot)
    assert turned.is_mirrored
    assert turned.residual == pytest.approx(straight.residual, rel=1e-6)
    angle_error = turned.rotation_deg - straight.rotation_deg - 130.0
    assert abs((angle_error + 180.0) % 360.0 - 180.0) < 1e-3


def test_a_real_robot_frame_is_aligned():
    recording = importers.load(shared_data("patterned-skin/inp_noPattern.csv"))
    similarity = alignment.fit(recording)
    assert similarity.is_mirrored and similarity.rival_residual > 3 * similarity.residual
    x, y = similarity(recording.frames["x_mm"], recording.frames["y_mm"])
    assert np.hypot(x, y).max() < 1.0, "every press lies on the skin"
