"""A rig's configuration, the mapping `rig` of a YAML file, refused in one line if it is wrong."""

import math
from dataclasses import replace
from pathlib import Path

import yaml

from eitskin import yaml_file
from eitskin.capture.interlock import Limits
from eitskin.capture.load_cell import LARGEST_N
from eitskin.capture.press_plan import places
from eitskin.capture.robot import STOP_S
from eitskin.data import board
from eitskin.data.board import Board
from eitskin.errors import InputError
from eitskin.physics.skin import ELECTRODE_PLACES, Skin
from eitskin.schema import Validator, dotted, explained

SCHEMA = Path(__file__).parent / "rig.schema.yaml"


def read(path: str | Path) -> dict:
    """The rig of a YAML file; raises InputError for one that cannot be driven safely."""
    document = yaml_file.read(path)
    if "rig" not in document:
        raise InputError(path, "rig", "nothing", "the mapping of a rig")
    validate(document["rig"], path)
    return document["rig"]


def validate(rig: object, file: str | Path) -> None:
    """Raise InputError naming `file` for a rig against its schema or unsafe to drive."""
    schema = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    errors = sorted(Validator(schema).iter_errors(rig), key=lambda error: len(error.absolute_path))
    if errors:
        place, violation, expected = explained(errors[0])
        raise InputError(file, dotted(["rig", *place]), violation, expected)
    assert isinstance(rig, dict)
    check(rig, file)


def check(rig: dict, file: str | Path) -> None:
    """Raise InputError naming `file` for a rig that its schema allows and that is unsafe.

    That is one whose plan leaves its box, whose limits contradict each other or are passed before
    the robot can stop, or whose skin does not suit its board.
    """
    skin = believed_skin(rig, file)
    eit_board = board_of(rig, file)
    n = eit_board.n_electrodes
    for key in ELECTRODE_PLACES:
        electrodes = getattr(skin, key)
        if electrodes is not None and len(electrodes) != n:
            electrode_count = f"{len(electrodes)} electrodes"
            raise InputError(file, f"rig.skin.{key}", electrode_count, f"{n}, as the board has")
    if eit_board.frame_s > eit_board.period_s:
        expected = f"at most period_s, {eit_board.period_s}"
        raise InputError(file, "rig.board.frame_s", eit_board.frame_s, expected)
    _check_limits(rig, file)
    _check_speeds(rig, file)
    _check_depths(rig, file)
    _check_box(rig, file)


def board_of(rig: dict, file: str | Path = "rig") -> Board:
    """The board, with the timing that the rig states anew.

    Raises InputError naming `file` for an unknown board, and the board's file for an invalid one.
    """
    described = board.read(rig["board"]["profile"], file, "rig.board.profile")
    timing = {key: rig["board"][key] for key in board.TIMING if key in rig["board"]}
    return replace(described, description=described.description | timing)


def believed_skin(rig: dict, file: str | Path = "rig") -> Skin:
    """The skin as the recording's metadata will state it."""
    believed = {key: value for key, value in rig["skin"].items() if key != "id"}
    return Skin.from_metadata(believed, f"{file}: rig")


def limits(rig: dict) -> Limits:
    """The limits in the form of the interlock."""
    return Limits(**rig["limits"])


def pressing_m_s(motion: dict) -> float:
    """The highest speed towards the skin in m/s."""
    return max(motion["press_m_s"], motion["search_m_s"])


def _check_limits(rig: dict, file: str | Path) -> None:
    """Refuse forces and stiffnesses that are not in their order."""
    limits, plan = rig["limits"], rig["plan"]
    if limits["hard_N"] > LARGEST_N:
        expected = f"at most {LARGEST_N:g} N, the largest reading that is believed"
        raise InputError(file, "rig.limits.hard_N", limits["hard_N"], expected)
    least_N, largest_N = plan["target_N"]
    if not least_N <= largest_N < limits["soft_N"]:
        expected = f"two forces in order, below limits.soft_N, {limits['soft_N']}"
        raise InputError(file, "rig.plan.target_N", [least_N, largest_N], expected)
    rise_N = limits["least_stiffness_N_per_mm"] * limits["rise_mm"]
    for place, value, limit, limit_text in (
        ("limits.soft_N", limits["soft_N"], limits["hard_N"], "hard_N"),
        ("limits.jump_N", limits["jump_N"], limits["hard_N"] - limits["soft_N"], "hard_N - soft_N"),
        ("limits.zero_N", limits["zero_N"], least_N, "a target"),
        ("plan.touch_N", plan["touch_N"], least_N, "a target"),
        ("plan.touch_N", plan["touch_N"], rise_N, "rise_mm times least_stiffness_N_per_mm"),
        (
            "limits.least_stiffness_N_per_mm",
            limits["least_stiffness_N_per_mm"],
            limits["stiffness_N_per_mm"],
            "stiffness_N_per_mm",
        ),
    ):
        if not value < limit:
            expected = f"less than {limit:g}, {limit_text}"
            raise InputError(file, f"rig.{place}", value, expected)


def _check_speeds(rig: dict, file: str | Path) -> None:
    """Refuse speeds and delays at which the robot cannot be stopped before the hard limit."""
    limits, plan, motion = rig["limits"], rig["plan"], rig["motion"]
    stiffness = limits["stiffness_N_per_mm"]
    braking_s = motion["travel_m_s"] / motion["stop_m_s2"]
    if braking_s > STOP_S:
        violation = f"{motion['stop_m_s2']} m/s²: {braking_s:g} s from {motion['travel_m_s']} m/s"
        raise InputError(file, "rig.motion.stop_m_s2", violation, f"at most {STOP_S} s")
    speed = pressing_m_s(motion)
    braking_m = 0.5 * speed**2 / motion["stop_m_s2"]
    margin_N = limits["hard_N"] - limits["soft_N"]
    for place, delay_s, cause in (
        ("rig.motion", limits["latency_s"], "before it is read and the arm stands"),
        ("rig.limits.watchdog_Hz", 1.0 / limits["watchdog_Hz"], "without the host"),
    ):
        growth_N = 1e3 * (speed * delay_s + braking_m) * stiffness
        if growth_N > margin_N * (1.0 + 1e-9):
            violation = f"{speed} m/s: the force grows by {growth_N:g} N {cause}"
            expected = f"at most {margin_N:g} N, from soft_N to hard_N"
            raise InputError(file, place, violation, expected)
    search_margin_N = limits["hard_N"] - plan["touch_N"]
    for key, delay_s in (
        ("stale_s", limits["stale_s"]),
        ("rejects", limits["rejects"] * limits["latency_s"]),
        ("frozen_readings", limits["frozen_readings"] * limits["latency_s"]),
    ):
        growth_N = 1e3 * motion["search_m_s"] * delay_s * stiffness
        if growth_N >= search_margin_N:
            violation = f"{limits[key]}: a search adds {growth_N:g} N before it is noticed"
            expected = f"less than {search_margin_N:g} N, from touch_N to hard_N"
            raise InputError(file, f"rig.limits.{key}", violation, expected)


def _check_depths(rig: dict, file: str | Path) -> None:
    """Refuse depths at which a skin may be pressed beyond the hard limit by a cell that fails."""
    limits, plan = rig["limits"], rig["plan"]
    stiffness, hard_N = limits["stiffness_N_per_mm"], limits["hard_N"]
    least_N, largest_N = plan["target_N"]
    # A cell that reads the stiffest skin like the softest, the least that is believed.
    touch_N = plan["touch_N"] * stiffness / limits["least_stiffness_N_per_mm"]
    touch_N += 1e3 * rig["motion"]["search_m_s"] * limits["latency_s"] * stiffness
    n_steps = math.ceil(limits["rise_mm"] / plan["step_mm"] * (1.0 - 1e-9)) + 1
    stepped_N = n_steps * plan["step_mm"] * stiffness
    for place, value_mm, reached_N, cause in (
        ("search_mm", plan["search_mm"], plan["search_mm"] * stiffness, "if no touch is felt"),
        (
            "depth_cap_mm",
            plan["depth_cap_mm"],
            touch_N + plan["depth_cap_mm"] * stiffness,
            "on the stiffest skin, whatever the load cell says",
        ),
        (
            "step_mm",
            plan["step_mm"],
            largest_N + stepped_N,
            f"{n_steps} steps from {largest_N} N on, before a deaf load cell is noticed",
        ),
    ):
        if not reached_N < hard_N:
            violation = f"{value_mm} mm: up to {reached_N:g} N {cause}"
            expected = f"less than hard_N, {hard_N} N"
            raise InputError(file, f"rig.plan.{place}", violation, expected)
    if plan["depth_cap_mm"] * stiffness < least_N:
        violation = f"{stiffness} N/mm: at most {plan['depth_cap_mm'] * stiffness:g} N at the cap"
        expected = f"a stiffest skin on which a target, {least_N} N, is reached"
        raise InputError(file, "rig.limits.stiffness_N_per_mm", violation, expected)


def _check_box(rig: dict, file: str | Path) -> None:
    """Refuse a plan of which a place, hovering or as deep as allowed, is outside the box."""
    box, centre, plan = rig["pose"]["box_m"], rig["pose"]["centre"], rig["plan"]
    for axis, (low, high) in zip("xyz", box, strict=True):
        if not low < high:
            place = f"rig.pose.box_m, {axis}"
            raise InputError(file, place, [low, high], "the smaller value first")
    if not math.isclose(math.pi, math.hypot(*centre[3:]), abs_tol=0.2):
        violation = f"a tool turned by {math.hypot(*centre[3:]):.3f} rad"
        raise InputError(file, "rig.pose.centre", violation, "about π rad: the probe points down")
    grid = places(plan)
    for axis, centre_m, offsets_mm in (
        ("x", centre[0], grid["x_mm"]),
        ("y", centre[1], grid["y_mm"]),
    ):
        low, high = box["xyz".index(axis)]
        positions_m = centre_m + 1e-3 * offsets_mm
        if positions_m.min() < low or positions_m.max() > high:
            violation = f"places from {positions_m.min():.4f} to {positions_m.max():.4f} m"
            raise InputError(file, f"rig.pose.box_m, {axis}", [low, high], f"more than {violation}")
    low, high = box[2]
    if not low < centre[2] - 1e-3 * plan["search_mm"] or not centre[2] <= high:
        violation = f"{low} to {high} m"
        expected = f"{plan['search_mm']} mm below the centre's {centre[2]} m, and it, to lie within"
        raise InputError(file, "rig.pose.box_m, z", violation, expected)
