import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rigsim import motion
from rigsim.log import EventLog
from rigsim.robot import Controller

coordinates = st.floats(-0.5, 0.5)
poses = st.tuples(*[coordinates] * 3).map(lambda xyz: np.array([*xyz, 0.0, 3.142, 0.0]))
speeds, accelerations = st.floats(0.001, 1.0), st.floats(0.01, 10.0)


@given(poses, poses, speeds, accelerations)
def test_a_line_ends_at_rest_on_its_target_and_never_above_its_speed(a, b, speed, acceleration):
    move = motion.line(a, b, speed, acceleration, t=5.0)
    end = max(move.end, 5.0)
    pose, velocity = move.at(end + 1.0)
    np.testing.assert_allclose(pose, b, atol=1e-9)
    assert not velocity.any() and not move.moving(end)
    times = np.linspace(5.0, end, 101)
    along = np.array([move.at(t)[1] for t in times])
    assert np.linalg.norm(along[:, :3], axis=1).max() <= speed * (1 + 1e-9)
    between = np.array([move.at(t)[0] for t in times])
    np.testing.assert_allclose(np.cross(between[:, :3] - a[:3], b[:3] - a[:3]), 0.0, atol=1e-9)


@given(speeds, accelerations, accelerations)
def test_a_stop_takes_half_the_square_of_the_speed_over_the_deceleration(speed, up, down):
    far = np.array([0.0, 0.0, -1e4, 0.0, 3.142, 0.0])
    move = motion.line(np.array([0, 0, 0, 0, 3.142, 0]), far, speed, up, t=0.0)
    t = 2.0 * speed / up
    stopping = motion.stop(move, down, t)
    way = np.linalg.norm(stopping.at(stopping.end)[0] - move.at(t)[0])
    np.testing.assert_allclose(way, speed**2 / (2.0 * down), rtol=1e-6, atol=1e-8)


@given(st.floats(1.0, 20.0), st.floats(0.001, 0.5))
def test_compressed_time_changes_when_the_tool_is_where_and_not_where_it_goes(speedup, t):
    slow, fast = (
        Controller("cb3", [0, 0, 0, 0, 3.142, 0], s, {}, EventLog("/dev/null"))
        for s in (1.0, speedup)
    )
    target = np.array([0.02, 0.0, -0.01, 0.0, 3.142, 0.0])
    for robot in (slow, fast):
        robot.move(target, 0.05, 0.3)
    np.testing.assert_allclose(fast.motion.at(t / speedup)[0], slow.motion.at(t)[0], atol=1e-9)


def test_a_change_of_speed_keeps_the_place_and_goes_on():
    move = motion.change_speed(motion.Motion.rest(np.zeros(6)), [0, 0, -0.01, 0, 0, 0], 0.1, 1.0)
    np.testing.assert_allclose(move.at(2.1)[0][2], -0.01 * 1.05)
    assert move.end == np.inf
