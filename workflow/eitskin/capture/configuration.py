"""A rig's configuration, the mapping `rig` of a YAML file, refused in one line if it is wrong."""

import math
from pathlib import Path

import yaml

from eitskin import yaml_file
from eitskin.capture.interlock import Limits
from eitskin.capture.press_plan import places
from eitskin.capture.wire import BOARDS
from eitskin.errors import InputError
from eitskin.physics.skin import Skin
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

    That is one whose plan leaves its box, whose limits are passed before the robot can stop, or
    whose skin does not suit its board.
    """
    skin = believed_skin(rig, file)
    n = BOARDS[rig["board"]["profile"]].n_electrodes
    if skin.electrode_deg is not None and len(skin.electrode_deg) != n:
        electrode_count = f"{len(skin.electrode_deg)} electrodes"
        raise InputError(file, "rig.skin.electrode_deg", electrode_count, f"{n}, as the board has")
    if rig["board"]["frame_s"] > rig["board"]["period_s"]:
        expected = f"at most period_s, {rig['board']['period_s']}"
        raise InputError(file, "rig.board.frame_s", rig["board"]["frame_s"], expected)
    _check_forces(rig, file)
    _check_box(rig, file)


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


def _check_forces(rig: dict, file: str | Path) -> None:
    """Refuse forces and speeds at which the robot cannot be stopped before the hard limit."""
    limits, plan, motion = rig["limits"], rig["plan"], rig["motion"]
    least_N, largest_N = plan["target_N"]
    if not least_N <= largest_N < limits["soft_N"]:
        expected = f"two forces in order, below limits.soft_N, {limits['soft_N']}"
        raise InputError(file, "rig.plan.target_N", [least_N, largest_N], expected)
    if not plan["touch_N"] < least_N:
        raise InputError(
            file, "rig.plan.touch_N", plan["touch_N"], f"less than {least_N}, a target"
        )
    speed = pressing_m_s(motion)
    margin_N = limits["hard_N"] - limits["soft_N"]
    for place, delay_s, cause in (
        ("rig.motion", limits["latency_s"], "before it is read"),
        ("rig.limits.watchdog_Hz", 1.0 / limits["watchdog_Hz"], "without the host"),
    ):
        growth_N = speed * 1e3 * delay_s * limits["stiffness_N_per_mm"]
        if growth_N > margin_N * (1.0 + 1e-9):
            violation = f"{speed} m/s: the force grows by {growth_N:g} N {cause}"
            expected = f"at most {margin_N:g} N, from soft_N to hard_N"
            raise InputError(file, place, violation, expected)
    step_N = plan["step_mm"] * limits["stiffness_N_per_mm"]
    if largest_N + step_N >= limits["hard_N"]:
        violation = f"{plan['step_mm']} mm, up to {step_N:g} N more"
        expected = f"a step from {largest_N} N that stays below hard_N, {limits['hard_N']}"
        raise InputError(file, "rig.plan.step_mm", violation, expected)


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
