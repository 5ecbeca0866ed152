"""The plan: every place with every probe, once, repeatably."""

import copy
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from eitskin.capture import configuration, preflight
from eitskin.capture.press_plan import contacts, plan_sha256
from eitskin.data import board
from eitskin.errors import InputError

PAPER = Path(__file__).parents[3] / "workflow" / "config" / "rig.yaml"
RIG = yaml.safe_load(PAPER.read_text(encoding="utf-8"))["rig"]


def changed_rig(*path: str, value: object) -> dict:
    """The paper's rig with one value changed."""
    rig = copy.deepcopy(RIG)
    node = rig
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return rig


def test_the_papers_plan():
    planned = contacts(RIG["plan"])
    assert [c.number for c in planned] == list(range(192 * 3))
    for probe in (7.0, 10.0, 15.0):
        places = [(c.x_mm, c.y_mm) for c in planned if c.probe_mm == probe]
        assert len(set(places)) == len(places) == 192
    assert [c.session for c in planned[::96]] == [
        "7 mm, 1",
        "7 mm, 2",
        "10 mm, 1",
        "10 mm, 2",
        "15 mm, 1",
        "15 mm, 2",
    ]
    assert all(8.0 <= c.target_N <= 10.0 for c in planned)
    radius = max((c.x_mm**2 + c.y_mm**2) ** 0.5 for c in planned)
    assert radius == pytest.approx(0.86 * 80.0)


@given(st.integers(1, 4), st.integers(1, 9), st.integers(1, 5), st.integers(0, 99))
def test_every_place_once_a_probe_and_the_same_each_time(radii, angles, sessions, seed):
    plan = RIG["plan"] | {"radii": radii, "angles": angles, "seed": seed}
    plan |= {"sessions_per_probe": sessions}
    planned = contacts(plan)
    assert planned == contacts(plan)
    assert len(planned) == 3 * radii * angles
    assert [c.probe_mm for c in planned] == sorted(c.probe_mm for c in planned)
    sizes = [sum(c.session == s for c in planned) for s in {c.session for c in planned}]
    assert max(sizes) - min(sizes) <= 1


def test_the_fingerprint_follows_what_decides_the_samples():
    original_sha256 = plan_sha256(RIG)
    assert plan_sha256(changed_rig("board", "port", value="/dev/ttyACM7")) == original_sha256
    assert plan_sha256(changed_rig("session", "operator", value="B")) == original_sha256
    assert plan_sha256(changed_rig("plan", "step_mm", value=0.5)) != original_sha256
    assert plan_sha256(changed_rig("limits", "soft_N", value=11.0)) == original_sha256
    assert (
        plan_sha256(changed_rig("pose", "centre", value=[-0.5, -0.2, -0.1, 0.0, 3.14, 0.0]))
        != original_sha256
    )
    assert plan_sha256(changed_rig("skin", "id", value="gelatin-2")) != original_sha256
    assert plan_sha256(changed_rig("emulated", value=True)) != original_sha256


def test_another_line_of_a_board_s_file_is_another_plan_its_timing_is_not(tmp_path):
    text = (board.FOLDER / "circular-16.yaml").read_text(encoding="utf-8")
    shas = []
    for old, new in (("0.742", "0.742"), ("0.742", "0.7"), ("frame_s: 0.3", "frame_s: 0.2")):
        path = tmp_path / "mine.yaml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        shas.append(plan_sha256(changed_rig("board", "profile", value=str(path))))
    assert shas[0] == shas[2] != shas[1]
    assert plan_sha256(RIG) not in shas


def test_a_board_s_file_that_is_missing_is_one_message(tmp_path):
    with pytest.raises(InputError, match=r"gone.yaml: file: found No such file"):
        configuration.validate(changed_rig("board", "profile", value="gone.yaml"), "rig.yaml")


def test_the_papers_rig_is_accepted():
    assert configuration.read(PAPER) == RIG


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("plan", "target_N"), [8.0, 12.0], "rig.plan.target_N: found .*below limits.soft_N, 12.0"),
        (("plan", "target_N"), [9.0, 8.0], "rig.plan.target_N: found .* two forces in order"),
        (("plan", "touch_N"), 8.0, "rig.plan.touch_N: found 8.0, expected less than 8, a target"),
        (("plan", "touch_N"), 0.21, "rig.plan.touch_N: found 0.21, expected less than 0.2, rise_m"),
        (
            ("plan", "step_mm"),
            3.0,
            "rig.plan.step_mm: found 3.0 mm: up to 22 N 2 steps from 10.0 N",
        ),
        (("plan", "search_mm"), 10.0, "rig.plan.search_mm: found 10.0 mm: up to 20 N if no touch"),
        (("plan", "depth_cap_mm"), 9.0, "rig.plan.depth_cap_mm: found 9.0 mm: up to 21.1 N on the"),
        (("plan", "radii"), 10**30, "rig.plan.radii: found 10+, expected 1000 or less"),
        (("plan", "angles"), 10**9, "rig.plan.angles: found 10+, expected 1000 or less"),
        (("pose", "box_m"), [[-0.69, -0.49], [-0.3, -0.1], [-0.1, 0.1]], "rig.pose.box_m, z"),
        (("plan", "radius_mm"), 200.0, "rig.pose.box_m, x"),
        (("plan", "probes_mm"), [7.0, 7.0], "rig.plan.probes_mm: .*without repetition"),
        (("motion", "press_m_s"), 0.02, "rig.motion: found 0.02 m/s: the force grows by 16.8 N"),
        (("motion", "press_m_s"), 0.01, "rig.motion: found 0.01 m/s: the force grows by 8.2 N"),
        (
            ("motion", "stop_m_s2"),
            1e-6,
            "rig.motion.stop_m_s2: found 1e-06 m/s²: 50000 s from 0.05",
        ),
        (("motion", "travel_m_s"), 1.0, "rig.motion.travel_m_s: found 1.0, expected 0.25 or less"),
        (
            ("limits", "watchdog_Hz"),
            2.0,
            "rig.limits.watchdog_Hz: found 0.009 m/s: .* 9.162 N with",
        ),
        (("limits", "watchdog_Hz"), 1.0, "rig.limits.watchdog_Hz: found 1.0, expected 2 or more"),
        (("limits", "watchdog_Hz"), 50.0, "rig.limits.watchdog_Hz: found 50.0, expected 20 or le"),
        (
            ("limits", "hard_N"),
            12.0,
            "rig.limits.soft_N: found 12.0, expected less than 12, hard_N",
        ),
        (
            ("limits", "hard_N"),
            1e9,
            "rig.limits.hard_N: found 1000000000.0, expected at most 500 N",
        ),
        (
            ("limits", "soft_N"),
            1e6,
            "rig.limits.soft_N: found 1000000.0, expected less than 20, hard",
        ),
        (
            ("limits", "jump_N"),
            9.0,
            "rig.limits.jump_N: found 9.0, expected less than 8, hard_N - ",
        ),
        (("limits", "zero_N"), 8.0, "rig.limits.zero_N: found 8.0, expected less than 8, a target"),
        (("limits", "rejects"), 10**9, "rig.limits.rejects: found 10+: a search adds 1.6e.09 N"),
        (
            ("limits", "frozen_readings"),
            13,
            "rig.limits.frozen_readings: found 13: a search adds 2",
        ),
        (("limits", "latency_s"), 1e-6, "rig.limits.latency_s: found 1e-06, expected 0.01 or more"),
        (
            ("limits", "stiffness_N_per_mm"),
            0.9,
            "rig.limits.stiffness_N_per_mm: .* 7.2 N at the cap",
        ),
        (
            ("limits", "least_stiffness_N_per_mm"),
            2.0,
            "least_stiffness_N_per_mm: .* less than 2, st",
        ),
        (("limits", "stale_s"), "1e-1", "rig.limits.stale_s: found '1e-1'"),
        (("pose", "centre"), [0.0] * 6, "rig.pose.centre: found a tool turned by 0.000 rad"),
        (("pose", "box_m"), [[1, 0], [0, 1], [0, 1]], "rig.pose.box_m, x: found .*smaller value"),
        (("skin", "electrode_deg"), [0.0, 90.0], "rig.skin.electrode_deg: found 2 electrodes"),
        (("skin", "colour"), "pink", "skin.colour: found an unknown key"),
        (("board", "profile"), "other", "rig.board.profile: found 'other', expected one of"),
        (("board", "frame_s"), 0.4, "rig.board.frame_s: found 0.4, expected at most period_s"),
        (("robot", "series"), "ur5", "rig.robot.series: found 'ur5', expected one of cb3, e"),
        (("name",), "../x", "rig.name: found '../x', expected a name of a-z"),
    ],
)
def test_a_rig_that_cannot_be_driven_safely_is_one_message(path, value, message):
    with pytest.raises(InputError, match=message) as refused:
        configuration.validate(changed_rig(*path, value=value), "rig.yaml")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("key", sorted(RIG["limits"]))
def test_no_limit_may_be_left_out(key):
    rig = copy.deepcopy(RIG)
    del rig["limits"][key]
    with pytest.raises(InputError, match=f"rig.limits.{key}: found no such key"):
        configuration.validate(rig, "rig.yaml")


@pytest.mark.parametrize("text", ["", "[1, 2]", "rig: {", "other: 1", "rig: 3"])
def test_a_file_that_holds_no_rig(tmp_path, text):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"rig\.yaml"):
        configuration.read(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="file"):
        configuration.read(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("height_mm", "ok", "text"),
    [
        (190.0, True, "a probe of 15 mm stays 18.7 mm within the skin's outline"),
        (150.0, False, "a probe of 15 mm goes 1.3 mm over the skin's outline"),
    ],
)
def test_presses_lie_on_an_outline(height_mm, ok, text):
    outline = {"shape": "rectangle", "width_mm": 300.0, "height_mm": height_mm}
    shares = [(k + 0.5) / 16 for k in range(16)]
    places = {"radius_mm": None, "electrode_deg": None, "outline": outline, "electrode_s": shares}
    rig = changed_rig("skin", value=RIG["skin"] | places)
    configuration.check(rig, "rig.yaml")
    assert preflight.plan(rig) == preflight.Finding("plan", ok, text)
    rig["skin"]["electrode_s"] = shares[:-1]
    with pytest.raises(
        InputError, match=r"rig\.skin\.electrode_s: found 15 electrodes, expected 16"
    ):
        configuration.check(rig, "rig.yaml")
