"""One press: untouched frames, down to the first touch, steps to the target, and up again.

It knows no device: `rig` moves, settles and takes frames, and raises where it must not go on.
"""

from collections.abc import Callable

import numpy as np

from eitskin.capture.interlock import Stop
from eitskin.capture.press_plan import Contact
from eitskin.capture.rig import Fault, Rig

STEP_GROWTH = 1.5  # a step may add this much more force than the last did


def press(
    rig: Rig,
    contact: Contact,
    keep: Callable[[dict], None],
    show: Callable[[dict], None],
) -> str:
    """Take the frames of one contact; returns why the press ended: `target`, `depth cap` or
    `stiff` (the next step might pass the soft limit).

    `keep` gets every frame as a record of the journal, `show` what a person wants to see. Raises
    Fault, Interrupted and RobotError as `Rig` does: the arm may then still move.
    """
    plan, motion, limits = (rig.config[key] for key in ("plan", "motion", "limits"))
    centre = rig.config["pose"]["centre"]
    x, y = centre[0] + 1e-3 * contact.x_mm, centre[1] + 1e-3 * contact.y_mm
    travel = (motion["travel_m_s"], motion["travel_m_s2"])
    pressing = (motion["press_m_s"], motion["press_m_s2"])
    hover = centre[2]
    rig.move((*rig.position_m[:2], hover), *travel)
    rig.move((x, y, hover), *travel)

    def take(phase: str, step: int, depth_mm: float | None) -> float:
        frame = rig.frame(plan["settle_s"])
        keep({"phase": phase, "step": step, "depth_mm": depth_mm, **frame})
        return frame["force_N"]

    rig.zero_N = 0.0
    show({"phase": "untouched", "depth_mm": None})
    untouched = [take("untouched", step, None) for step in range(plan["untouched_frames"])]
    rig.zero_N = float(np.median(untouched))
    if abs(rig.zero_N) > limits["zero_N"]:
        said = f"{rig.zero_N:.3f} N with nothing touched (limit {limits['zero_N']} N)"
        raise Fault(Stop("load cell zero", f"the load cell has drifted: {said}; zero it anew"))

    show({"phase": "search", "depth_mm": None})
    surface = _surface_m(rig, x, y, hover)

    def lower_to(step: int) -> float:
        depth_m = 1e-3 * plan["step_mm"] * step
        show({"phase": "press", "depth_mm": 1e3 * depth_m})
        rig.move((x, y, surface - depth_m), *pressing)
        return 1e3 * (surface - rig.position_m[2])

    force_N, growth_N, step, end = rig.force_N, 0.0, 0, ""
    while force_N < contact.target_N:
        end = _no_further(rig, surface, step + 1, force_N + STEP_GROWTH * growth_N)
        if end:
            break
        step += 1
        depth_mm = lower_to(step)
        before_N, force_N = force_N, take("press", step, depth_mm) - rig.zero_N
        growth_N = max(growth_N, force_N - before_N)
    for _ in range(plan["hold_frames"] if step else 0):
        take("hold", step, 1e3 * (surface - rig.position_m[2]))
    if plan["unload"]:
        for upper in range(step - 1, 0, -1):
            take("unload", upper, lower_to(upper))
    show({"phase": "up", "depth_mm": None})
    rig.move((x, y, hover), *travel)
    return end or "target"


def _surface_m(rig: Rig, x: float, y: float, hover: float) -> float:
    """The height at which the probe, lowered from `hover` at (x, y), m, touches; raises Fault where
    it does not."""
    plan, motion = rig.config["plan"], rig.config["motion"]
    lowest = hover - 1e-3 * plan["search_mm"]
    search = (motion["search_m_s"], motion["press_m_s2"])
    if rig.move((x, y, lowest), *search, until=lambda: rig.touches(plan["touch_N"])):
        said = f"no touch within {plan['search_mm']} mm below {hover} m"
        raise Fault(Stop("no touch", f"{said}: is the skin there, does the load cell feel?"))
    return rig.position_m[2]


def _no_further(rig: Rig, surface: float, step: int, force_N: float) -> str:
    """Why a step below the surface, a height in m, must not be taken, after which the force may be
    force_N; nothing where it may."""
    plan, floor = rig.config["plan"], rig.config["pose"]["box_m"][2][0]
    depth_mm = plan["step_mm"] * step
    if depth_mm > plan["depth_cap_mm"] or surface - 1e-3 * depth_mm < floor:
        return "depth cap"
    return "stiff" if force_N > rig.config["limits"]["soft_N"] else ""
