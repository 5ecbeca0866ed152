"""The interlock: every reason to stop, by table and by property."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.capture.interlock import Limits, State, judge, judge_rise

LIMITS = Limits(
    soft_N=12.0,
    hard_N=20.0,
    zero_N=0.3,
    jump_N=4.0,
    stale_s=0.5,
    watchdog_Hz=10.0,
    clock_s=0.2,
    rejects=5,
    frozen_readings=8,
    latency_s=0.4,
    stiffness_N_per_mm=2.0,
    least_stiffness_N_per_mm=0.2,
    rise_mm=1.0,
)
BOX = ((-0.7, -0.5), (-0.3, -0.1), (-0.12, 0.1))
SAFE_STATE = State(
    now_s=100.0,
    force_N=5.0,
    zero_N=0.01,
    force_s=99.9,
    jump_N=0.4,
    load_rejects=0,
    frozen_readings=1,
    load_restarts=0,
    load_failure=None,
    robot_failure=None,
    robot_clock_s=99.99,
    robot_mode=7,
    safety_mode=1,
    safety_bits=1,
    runtime_state=2,
    pose_m=(-0.6, -0.2, -0.1),
)
FORCE = {
    "force": {"force_N": 12.1},
    "force jump": {"jump_N": 4.1},
    "load cell silent": {"force_s": 99.4},
    "load cell rejects": {"load_rejects": 5},
    "load cell frozen": {"frozen_readings": 8},
    "load cell restart": {"load_restarts": 1},
    "load cell lost": {"load_failure": "unplugged"},
}
ROBOT = {
    "robot lost": {"robot_failure": "ended with -11"},
    "robot clock": {"robot_clock_s": 99.7},
    "robot safety": {"safety_mode": 3, "safety_bits": 0b100},
    "robot mode": {"robot_mode": 5},
    "robot program": {"runtime_state": 1},
}


def judge_state(**changed: object) -> str | None:
    stop = judge(dataclasses.replace(SAFE_STATE, **changed), LIMITS, BOX)
    return None if stop is None else stop.reason


def test_nothing_is_wrong():
    assert judge_state() is None
    assert judge_state(retreat_from_N=5.0) is None


@pytest.mark.parametrize("reason", [*FORCE, *ROBOT])
def test_every_reason_alone(reason):
    assert judge_state(**(FORCE | ROBOT)[reason]) == reason


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"force_N": -12.1}, "force"),
        ({"force_N": 12.0, "zero_N": -0.2}, "force"),
        ({"force_N": math.nan}, "force"),
        ({"zero_N": math.nan}, "force"),
        ({"jump_N": math.nan}, "force jump"),
        ({"force_s": -math.inf}, "load cell silent"),
        ({"force_s": math.nan}, "load cell silent"),
        ({"robot_clock_s": -math.inf}, "robot clock"),
        ({"robot_clock_s": math.nan}, "robot clock"),
        ({"safety_bits": 0b11}, "robot safety"),
        ({"safety_bits": 0}, "robot safety"),
        ({"safety_mode": 7, "robot_mode": 3}, "robot safety"),
        ({"pose_m": (-0.6, -0.2, -0.1201)}, "place"),
        ({"pose_m": (-0.6, -0.2, math.nan)}, "place"),
        ({"pose_m": (-0.49, -0.2, -0.1)}, "place"),
        ({"pose_m": (-0.6, -0.31, -0.1)}, "place"),
        ({"pose_m": (-0.6, -0.2, 0.11)}, "place"),
    ],
)
def test_what_else_is_a_reason(changed, reason):
    assert judge_state(**changed) == reason


@pytest.mark.parametrize("reason", FORCE)
def test_a_retreat_goes_on_whatever_the_load_cell_says(reason):
    assert judge_state(**FORCE[reason], retreat_from_N=12.1) is None


@pytest.mark.parametrize("reason", ROBOT)
def test_a_retreat_ends_where_the_robot_is_not_itself(reason):
    assert judge_state(**ROBOT[reason], retreat_from_N=12.1) == reason


def test_a_retreat_ends_where_the_force_grows():
    assert judge_state(force_N=16.2, retreat_from_N=12.1) == "retreat force"
    assert judge_state(force_N=12.5, retreat_from_N=1.0) == "retreat force"


def test_a_retreat_may_begin_below_the_box_but_not_beside_it():
    assert judge_state(pose_m=(-0.6, -0.2, -0.13), retreat_from_N=5.0) is None
    assert judge_state(pose_m=(-0.4, -0.2, -0.13), retreat_from_N=5.0) == "place"
    assert judge_state(pose_m=(-0.6, -0.2, math.nan), retreat_from_N=5.0) == "place"


@pytest.mark.parametrize(
    ("depths_mm", "forces_N", "stops"),
    [
        ([0.0], [0.15], False),
        ([0.0, 0.5], [0.15, 0.15], False),  # too little depth to tell
        ([0.0, 0.5, 1.0], [0.15, 0.15, 0.36], False),
        ([0.0, 0.5, 1.0], [0.15, 0.3, 0.34], True),
        ([0.0, 3.0], [0.15, 0.74], True),
        ([0.0, 3.0], [0.15, 0.76], False),
        ([0.0, 1.0, 2.0], [0.15, 5.0, 5.1], True),
        ([0.0, 1.0, 1.2], [0.15, 5.0, 4.6], True),
        ([0.0, 1.0, 1.2], [0.15, 5.0, 4.8], False),
        ([0.0, 0.1], [0.15, math.nan], True),
        ([0.0, 1.0], [0.15, math.nan], True),
    ],
)
def test_the_force_must_follow_the_depth(depths_mm, forces_N, stops):
    stop = judge_rise(depths_mm, forces_N, LIMITS)
    assert (stop is not None and stop.reason == "load cell deaf") == stops


@given(st.floats(0.21, 5.0), st.floats(0.1, 3.0), st.integers(1, 20))
def test_no_skin_within_the_stated_stiffness_is_a_deaf_cell(N_per_mm, step_mm, steps):
    depths_mm = [step_mm * step for step in range(steps + 1)]
    forces_N = [0.15 + N_per_mm * depth_mm for depth_mm in depths_mm]
    assert judge_rise(depths_mm, forces_N, LIMITS) is None


NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


@given(force_N=NUMBERS, zero_N=NUMBERS, force_s=NUMBERS, jump_N=NUMBERS, clock_s=NUMBERS)
def test_going_on_needs_every_number_within_its_limit(force_N, zero_N, force_s, jump_N, clock_s):
    state = dataclasses.replace(
        SAFE_STATE,
        force_N=force_N,
        zero_N=zero_N,
        force_s=force_s,
        jump_N=jump_N,
        robot_clock_s=clock_s,
    )
    if judge(state, LIMITS, BOX) is None:
        assert abs(force_N) <= 12.0
        assert abs(force_N - zero_N) <= 12.0
        assert 100.0 - force_s <= 0.5
        assert jump_N <= 4.0
        assert 100.0 - clock_s <= 0.2


@given(st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_going_on_needs_a_place_inside_the_box(pose_m):
    inside = all(low <= value <= high for value, (low, high) in zip(pose_m, BOX, strict=True))
    assert (judge_state(pose_m=pose_m) is None) == inside


@given(st.integers(-1, 9), st.integers(0, 12), st.integers(0, 2**12), st.integers(0, 5))
def test_going_on_needs_a_robot_that_runs_normally(mode, safety, bits, runtime):
    stop = judge_state(robot_mode=mode, safety_mode=safety, safety_bits=bits, runtime_state=runtime)
    assert (stop is None) == ((mode, safety, bits, runtime) == (7, 1, 1, 2))
