"""When the robot must stop: a function of what is known now, and of the limits.

Software that watches a robot is no safety function. The robot's own force limits and safety planes
must be set so that nobody is hurt when all of this fails.
"""

import math
from dataclasses import dataclass

RUNNING = 7  # robot_mode
NORMAL_SAFETY = 1  # safety_mode
PLAYING = 2  # runtime_state
SAFE_BITS = 0b1  # safety_status_bits: normal mode and nothing else
STILL_M_S = 5e-4  # a TCP that is slower stands


@dataclass(frozen=True)
class Limits:
    """What a run may not exceed; units in the names."""

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


@dataclass(frozen=True)
class State:
    """What is known at a moment (host's monotonic seconds). Positions in m in the robot's base."""

    now_s: float
    force_N: float  # as read
    zero_N: float  # what the untouched cell read last
    force_s: float  # when the last reading came
    jump_N: float  # largest step between readings since the last look
    load_rejects: int  # in a row, up to now
    frozen_readings: int  # equal ones in a row, up to now
    load_restarts: int  # greetings since the run began
    load_lost: str | None  # why the load cell's port is gone
    robot_lost: str | None  # why the robot's process is gone
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
    """The first reason to stop, or None. Anything that is not a finite number is a reason.

    box_m: smallest and largest x, y and z. While retreating upward the load cell may say anything
    but a force that grows, and z may lie below the box: standing still would be worse.
    """
    return _robot(state, limits) or _place(state, box_m) or _force(state, limits)


def _robot(state: State, limits: Limits) -> Stop | None:
    if state.robot_lost is not None:
        return Stop("robot lost", f"the robot's connection is gone: {state.robot_lost}")
    still = state.now_s - state.robot_clock_s
    if not still <= limits.clock_s:
        said = f"the robot's clock has stood still for {still:.2f} s (limit {limits.clock_s} s)"
        return Stop("robot clock", said)
    if state.safety_mode != NORMAL_SAFETY or state.safety_bits != SAFE_BITS:
        said = f"safety mode {state.safety_mode}, status bits {state.safety_bits:#x}"
        return Stop("robot safety", f"the robot's safety system has acted: {said}")
    if state.robot_mode != RUNNING:
        return Stop("robot mode", f"the robot is not running: robot mode {state.robot_mode}")
    if state.runtime_state != PLAYING:
        said = f"runtime state {state.runtime_state}, expected {PLAYING}"
        return Stop("robot program", f"the robot's program does not play: {said}")
    return None


def _place(state: State, box_m: tuple[tuple[float, float], ...]) -> Stop | None:
    for axis, value, (low, high) in zip("xyz", state.pose_m, box_m, strict=True):
        if axis == "z" and state.retreat_from_N is not None and math.isfinite(value):
            low = -math.inf
        if not low <= value <= high:
            said = f"{axis} = {value:.4f} m, outside {low} to {high} m"
            return Stop("place", f"the probe has left its box: {said}")
    return None


def _force(state: State, limits: Limits) -> Stop | None:
    if state.retreat_from_N is not None:
        ceiling = max(limits.soft_N, state.retreat_from_N + limits.jump_N)
        if state.force_N > ceiling:
            said = f"{state.force_N:.2f} N, more than at its start"
            return Stop("retreat force", f"the force grows during the retreat: {said}")
        return None
    if state.load_lost is not None:
        return Stop("load cell lost", f"the load cell's port is gone: {state.load_lost}")
    if state.load_restarts:
        return Stop("load cell restart", "the load cell restarted: its zero is not known any more")
    age = state.now_s - state.force_s
    if not age <= limits.stale_s:
        said = f"silent for {age:.2f} s (limit {limits.stale_s} s)"
        return Stop("load cell silent", f"the load cell is {said}")
    if state.load_rejects >= limits.rejects:
        said = f"{state.load_rejects} lines in a row were no reading"
        return Stop("load cell rejects", f"the load cell cannot be read: {said}")
    if state.frozen_readings >= limits.frozen_readings:
        said = f"{state.frozen_readings} times exactly {state.force_N} N"
        return Stop("load cell frozen", f"the load cell repeats itself: {said}")
    for force in (state.force_N, state.force_N - state.zero_N):
        if not abs(force) <= limits.soft_N:
            said = f"{force:.2f} N (limit {limits.soft_N} N)"
            return Stop("force", f"the force is too large: {said}")
    if not state.jump_N <= limits.jump_N:
        said = f"{state.jump_N:.2f} N between two readings (limit {limits.jump_N} N)"
        return Stop("force jump", f"the force jumped: {said}")
    return None
