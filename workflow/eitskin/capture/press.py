"""One press: untouched frames, down to the first touch, steps to the target force, and up again.

No device is used directly: `rig` moves, settles and takes frames, and raises where it must stop.
"""

from collections.abc import Callable

import numpy as np

from eitskin.capture.configuration import limits as limits_of
from eitskin.capture.interlock import Stop, judge_rise
from eitskin.capture.press_plan import Contact
from eitskin.capture.rig import Fault, Rig

STEP_GROWTH = 1.5  # a step may add this factor times the force of the last: skins stiffen


def press(
    rig: Rig,
    contact: Contact,
    record_frame: Callable[[dict], None],
    show: Callable[[dict], None],
) -> str:
    """Take the frames of one contact.

    Returns why the press ended: `target`, `depth cap` or `stiff` (the next step might pass the soft
    limit). `record_frame` gets every frame as a record of the journal, `show` the progress. Raises
    Fault, Interrupted and RobotError as `Rig` does, and Fault where load cell or board do not
    follow the arm, down to its release; the arm may then still move.
    """
    plan, motion, limits = rig.config["plan"], rig.config["motion"], limits_of(rig.config)
    centre = rig.config["pose"]["centre"]
    x_m, y_m = centre[0] + 1e-3 * contact.x_mm, centre[1] + 1e-3 * contact.y_mm
    travel_motion = (motion["travel_m_s"], motion["travel_m_s2"])
    press_motion = (motion["press_m_s"], motion["press_m_s2"])
    hover_m = centre[2]
    rig.move((*rig.position_m[:2], hover_m), *travel_motion)
    rig.move((x_m, y_m, hover_m), *travel_motion)

    recorded_line = ""  # the board's, of the frame recorded before

    def take_frame(phase: str, step: int, depth_mm: float | None) -> float:
        nonlocal recorded_line
        frame = rig.frame(plan["settle_s"])
        if phase in ("press", "unload"):
            _check_board(frame["raw"], recorded_line)
        recorded_line = frame["raw"]
        record_frame({"phase": phase, "step": step, "depth_mm": depth_mm, **frame})
        return frame["force_N"]

    rig.zero_N = 0.0
    show({"phase": "untouched", "depth_mm": None})
    untouched_N = [take_frame("untouched", step, None) for step in range(plan["untouched_frames"])]
    rig.zero_N = float(np.median(untouched_N))
    if abs(rig.zero_N) > limits.zero_N:
        detail = f"{rig.zero_N:.3f} N with nothing touched (limit {limits.zero_N} N)"
        raise Fault(Stop("load cell zero", f"the load cell has drifted: {detail}; zero it anew"))

    show({"phase": "search", "depth_mm": None})
    surface_m = _surface_m(rig, x_m, y_m, hover_m)

    def lower_to(step: int) -> float:
        depth_m = 1e-3 * plan["step_mm"] * step
        show({"phase": "press", "depth_mm": 1e3 * depth_m})
        rig.move((x_m, y_m, surface_m - depth_m), *press_motion)
        return 1e3 * (surface_m - rig.position_m[2])

    def check_rise(depths_mm: list[float], forces_N: list[float]) -> None:
        stop = judge_rise(depths_mm, forces_N, limits)
        if stop is not None:
            raise Fault(stop)

    force_N, growth_N, step, end_reason = rig.force_N, 0.0, 0, ""
    depths_mm, forces_N = [0.0], [force_N]
    while force_N < contact.target_N:
        end_reason = _step_limit(rig, surface_m, step + 1, force_N + STEP_GROWTH * growth_N)
        if end_reason:
            break
        step += 1
        depth_mm = lower_to(step)
        before_N, force_N = force_N, take_frame("press", step, depth_mm) - rig.zero_N
        growth_N = max(growth_N, force_N - before_N)
        depths_mm.append(plan["step_mm"] * step)
        forces_N.append(force_N)
        check_rise(depths_mm, forces_N)
    for _ in range(plan["hold_frames"] if step else 0):
        held_N = take_frame("hold", step, 1e3 * (surface_m - rig.position_m[2])) - rig.zero_N
        check_rise([depths_mm[0], depths_mm[-1]], [forces_N[0], held_N])
    if plan["unload"]:
        for unload_step in range(step - 1, 0, -1):
            take_frame("unload", unload_step, lower_to(unload_step))
    show({"phase": "up", "depth_mm": None})
    rig.move((x_m, y_m, hover_m), *travel_motion)
    released = rig.frame(limits.latency_s)
    if step:
        _check_board(released["raw"], recorded_line)
    change_N = released["force_N"] - rig.zero_N
    if abs(change_N) > limits.zero_N:
        detail = f"{change_N:+.3f} N from before the press to after it (limit {limits.zero_N} N)"
        raise Fault(Stop("load cell zero", f"the load cell has drifted: {detail}; zero it anew"))
    return end_reason or "target"


def _check_board(line: str, recorded_line: str) -> None:
    """Raise Fault where the board prints at one depth what it printed at another."""
    if line == recorded_line:
        detail = "the same frame at two depths, to the last digit"
        raise Fault(Stop("board frozen", f"the board repeats itself: {detail}"))


def _surface_m(rig: Rig, x_m: float, y_m: float, hover_m: float) -> float:
    """The height in m at which the probe, lowered from `hover_m`, touches the skin.

    Raises Fault where it does not touch.
    """
    plan, motion = rig.config["plan"], rig.config["motion"]
    lowest_m = hover_m - 1e-3 * plan["search_mm"]
    search_motion = (motion["search_m_s"], motion["press_m_s2"])
    if rig.move((x_m, y_m, lowest_m), *search_motion, until=lambda: rig.touches(plan["touch_N"])):
        detail = f"no touch within {plan['search_mm']} mm below {hover_m} m"
        raise Fault(Stop("no touch", f"{detail}: is the skin there, does the load cell feel?"))
    return rig.position_m[2]


def _step_limit(rig: Rig, surface_m: float, step: int, force_N: float) -> str:
    """Why step `step` below the surface must not be taken, "" where it may.

    `force_N` is the largest force expected after it.
    """
    plan, floor_m = rig.config["plan"], rig.config["pose"]["box_m"][2][0]
    depth_mm = plan["step_mm"] * step
    if depth_mm > plan["depth_cap_mm"] or surface_m - 1e-3 * depth_mm < floor_m:
        return "depth cap"
    return "stiff" if force_N > rig.config["limits"]["soft_N"] else ""
