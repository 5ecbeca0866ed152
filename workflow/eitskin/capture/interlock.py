"""When the robot must stop: a function of the state of all devices and of the limits.

Software that watches a robot is no safety function. The robot's own force limits and safety planes
must be set so that nobody is hurt when all of this fails.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

# Values of RTDE's fields: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
RUNNING = 7  # robot_mode
NORMAL_SAFETY = 1  # safety_mode
PLAYING = 2  # runtime_state
SAFE_BITS = 0b1  # safety_status_bits: normal mode and nothing else
STILL_M_S = 5e-4  # speed of the TCP below which it counts as standing: above its noise at rest


@dataclass(frozen=True)
class Limits:
    """The limits of a run; units in the names."""

    soft_N: float  # force at which the robot is stopped
    hard_N: float  # force that must never act; soft is far enough below it
    zero_N: float  # force that the untouched cell may read
    jump_N: float  # between two readings
    stale_s: float  # age of the last force reading
    clock_s: float  # for which the robot's clock may stand still
    watchdog_Hz: float  # how often the controller must hear of its host, or it stops the arm
    rejects: int  # lines in a row that are no reading
    frozen_readings: int  # exactly equal force readings in a row
    latency_s: float  # from a force to its reading
    stiffness_N_per_mm: float  # of the stiffest skin pressed
    least_stiffness_N_per_mm: float  # of the softest skin pressed
    rise_mm: float  # depth over which the force must rise as that of the softest skin


@dataclass(frozen=True)
class State:
    """The state of all devices at one moment of the host's monotonic clock; positions in m in the
    robot's base frame."""

    now_s: float
    force_N: float  # as read
    zero_N: float  # what the untouched cell read last
    force_s: float  # time of the last reading
    jump_N: float  # largest step between readings since the last state
    load_rejects: int  # in a row, up to now
    frozen_readings: int  # equal ones in a row, up to now
    load_restarts: int  # greetings since the run began
    load_failure: str | None  # why the load cell's port was lost
    robot_failure: str | None  # why the robot's process ended
    robot_clock_s: float  # when the robot's clock last advanced
    robot_mode: int
    safety_mode: int
    safety_bits: int
    runtime_state: int
    pose_m: tuple[float, float, float]
    retreat_from_N: float | None = None  # force at the start of a retreat straight up


@dataclass(frozen=True)
class Stop:
    """Why the robot must stop; `reason` is a word to count by, `message` for a person."""

    reason: str
    message: str


def judge(state: State, limits: Limits, box_m: tuple[tuple[float, float], ...]) -> Stop | None:
    """The first reason to stop, or None; a number that is not finite is a reason.

    `box_m` holds smallest and largest x, y and z. During a retreat upward only a growing force and
    x, y outside the box are reasons: standing still on the skin would be worse.
    """
    return _robot_stop(state, limits) or _place_stop(state, box_m) or _force_stop(state, limits)


def _robot_stop(state: State, limits: Limits) -> Stop | None:
    if state.robot_failure is not None:
        return Stop("robot lost", f"the robot's connection is gone: {state.robot_failure}")
    still_s = state.now_s - state.robot_clock_s
    if not still_s <= limits.clock_s:
        detail = f"the robot's clock has stood still for {still_s:.2f} s (limit {limits.clock_s} s)"
        return Stop("robot clock", detail)
    if state.safety_mode != NORMAL_SAFETY or state.safety_bits != SAFE_BITS:
        detail = f"safety mode {state.safety_mode}, status bits {state.safety_bits:#x}"
        return Stop("robot safety", f"the robot's safety system has acted: {detail}")
    if state.robot_mode != RUNNING:
        return Stop("robot mode", f"the robot is not running: robot mode {state.robot_mode}")
    if state.runtime_state != PLAYING:
        detail = f"runtime state {state.runtime_state}, expected {PLAYING}"
        return Stop("robot program", f"the robot's program does not play: {detail}")
    return None


def _place_stop(state: State, box_m: tuple[tuple[float, float], ...]) -> Stop | None:
    for axis, value, (low, high) in zip("xyz", state.pose_m, box_m, strict=True):
        if axis == "z" and state.retreat_from_N is not None and math.isfinite(value):
            low = -math.inf
        if not low <= value <= high:
            detail = f"{axis} = {value:.4f} m, outside {low} to {high} m"
            return Stop("place", f"the probe has left its box: {detail}")
    return None


def _force_stop(state: State, limits: Limits) -> Stop | None:
    if state.retreat_from_N is not None:
        ceiling = max(limits.soft_N, state.retreat_from_N + limits.jump_N)
        if state.force_N > ceiling:
            detail = f"{state.force_N:.2f} N, more than at its start"
            return Stop("retreat force", f"the force grows during the retreat: {detail}")
        return None
    if state.load_failure is not None:
        return Stop("load cell lost", f"the load cell's port is gone: {state.load_failure}")
    if state.load_restarts:
        return Stop("load cell restart", "the load cell restarted: its zero is not known any more")
    age = state.now_s - state.force_s
    if not age <= limits.stale_s:
        detail = f"silent for {age:.2f} s (limit {limits.stale_s} s)"
        return Stop("load cell silent", f"the load cell is {detail}")
    if state.load_rejects >= limits.rejects:
        detail = f"{state.load_rejects} lines in a row were no reading"
        return Stop("load cell rejects", f"the load cell cannot be read: {detail}")
    if state.frozen_readings >= limits.frozen_readings:
        detail = f"{state.frozen_readings} times exactly {state.force_N} N"
        return Stop("load cell frozen", f"the load cell repeats itself: {detail}")
    for force in (state.force_N, state.force_N - state.zero_N):
        if not abs(force) <= limits.soft_N:
            detail = f"{force:.2f} N (limit {limits.soft_N} N)"
            return Stop("force", f"the force is too large: {detail}")
    if not state.jump_N <= limits.jump_N:
        detail = f"{state.jump_N:.2f} N between two readings (limit {limits.jump_N} N)"
        return Stop("force jump", f"the force jumped: {detail}")
    return None


def judge_rise(
    depths_mm: Sequence[float], forces_N: Sequence[float], limits: Limits
) -> Stop | None:
    """The reason to stop a press in which the force does not follow the depth, or None.

    `depths_mm` (n,) below the first touch grow, `forces_N` (n,) are the load cell's there. A cell
    that sticks, saturates, drifts or has lost its bridge reads forces that no skin has: the last is
    smaller than an earlier one by more than `zero_N`, or larger than that `rise_mm` or more above
    by less than the softest skin adds.
    """
    *earlier_depths_mm, depth_mm = depths_mm
    *earlier_forces_N, force_N = forces_N
    largest_N = max(earlier_forces_N, default=-math.inf)
    if not force_N >= largest_N - limits.zero_N:
        detail = f"{force_N:.2f} N at {depth_mm:g} mm, {largest_N:.2f} N above"
        return Stop("load cell deaf", f"the force falls while the depth grows: {detail}")
    for earlier_mm, earlier_N in zip(earlier_depths_mm[::-1], earlier_forces_N[::-1], strict=True):
        grown_mm = depth_mm - earlier_mm
        if grown_mm < limits.rise_mm * (1.0 - 1e-9):
            continue
        least_N = limits.least_stiffness_N_per_mm * grown_mm
        if not force_N - earlier_N >= least_N:
            detail = f"{force_N - earlier_N:.2f} N over {grown_mm:g} mm, at least {least_N:.2f} N"
            return Stop("load cell deaf", f"the force does not rise with the depth: {detail}")
        return None
    return None
