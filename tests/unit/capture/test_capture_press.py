"""One press on a pretended rig: a spring under the probe, no devices and no time."""

import copy
import math
from pathlib import Path

import pytest
import yaml

pytest.importorskip("serial", reason="pyserial is not installed: extra `rig`")

from eitskin.capture.press import press
from eitskin.capture.press_plan import Contact
from eitskin.capture.rig import Fault

PAPER = Path(__file__).parents[3] / "workflow" / "config" / "rig.yaml"
CONTACT = Contact(number=0, probe_mm=7.0, session="7 mm, 1", x_mm=10.0, y_mm=-20.0, target_N=8.5)
SEARCHED_MM = 0.2  # below the surface, where a search ends


class Spring:
    """A robot that is where it is sent, over a skin `clearance_mm` below the centre's height.

    `felt` is what the load cell makes of the true force, `printed` what the board makes of it.
    """

    def __init__(
        self,
        N_per_mm: float,
        clearance_mm: float = 5.0,
        offset_N: float = 0.0,
        felt=lambda force_N: force_N,
        printed=str,
        **plan,
    ):
        self.config = copy.deepcopy(yaml.safe_load(PAPER.read_text(encoding="utf-8"))["rig"])
        self.config["plan"] |= plan
        self.N_per_mm, self.offset_N, self.zero_N = N_per_mm, offset_N, 0.0
        self.position_m = tuple(self.config["pose"]["centre"][:3])
        self.surface_m = self.position_m[2] - 1e-3 * clearance_mm
        self.moves: list[tuple] = []
        self.felt, self.printed, self.largest_N = felt, printed, 0.0

    @property
    def depth_mm(self) -> float:
        return max(0.0, 1e3 * (self.surface_m - self.position_m[2]))

    @property
    def force_N(self) -> float:
        return self.felt(self.N_per_mm * self.depth_mm) + self.offset_N - self.zero_N

    def touches(self, force_N: float) -> bool:
        return self.force_N >= force_N

    def move(self, position_m, speed_m_s, acceleration_m_s2, until=None) -> bool:
        sideways = position_m[:2] != self.position_m[:2]
        assert not (sideways and self.depth_mm), "the probe was dragged over the skin"
        assert not (sideways and position_m[2] != self.position_m[2])
        if until is not None and position_m[2] < self.surface_m - 1e-3 * SEARCHED_MM:
            self.position_m = (*position_m[:2], self.surface_m - 1e-3 * SEARCHED_MM)
            assert until()
            return False
        self.position_m = tuple(position_m)
        self.moves.append((self.depth_mm, speed_m_s))
        self.largest_N = max(self.largest_N, self.N_per_mm * self.depth_mm)
        return True

    def frame(self, settle_s: float) -> dict:
        lifted = self.moves[-1][0] == 0.0 and any(depth for depth, _ in self.moves)
        latency_s = self.config["limits"]["latency_s"]
        assert settle_s == (latency_s if lifted else self.config["plan"]["settle_s"])
        raw = self.printed(self.N_per_mm * self.depth_mm)
        return {"force_N": self.force_N + self.zero_N, "zero_N": self.zero_N, "raw": raw}


def press_on(rig: Spring) -> tuple[str, list[dict]]:
    frame_records: list[dict] = []
    return press(rig, CONTACT, frame_records.append, lambda news: None), frame_records


def phases(frame_records: list[dict]) -> list[str]:
    return [frame["phase"] for frame in frame_records]


def test_steps_of_a_millimetre_to_the_target_and_up_again():
    rig = Spring(2.0, offset_N=0.1)
    end, frame_records = press_on(rig)
    assert end == "target"
    assert phases(frame_records) == ["untouched"] * 2 + ["press"] * 5
    assert [f["depth_mm"] for f in frame_records[2:]] == pytest.approx([1, 2, 3, 4, 5])
    assert frame_records[-1]["force_N"] - frame_records[-1]["zero_N"] >= CONTACT.target_N
    assert [f["zero_N"] for f in frame_records] == pytest.approx([0.0] * 2 + [0.1] * 5)
    assert rig.position_m == pytest.approx((-0.583, -0.221, -0.092))


def test_into_the_skin_it_is_never_faster_than_a_press():
    rig = Spring(2.0)
    press_on(rig)
    deep = [speed for depth, speed in rig.moves if depth > 0]
    assert set(deep) == {rig.config["motion"]["press_m_s"]}


def test_the_depth_cap_is_tested_before_the_step():
    rig = Spring(0.8, depth_cap_mm=7.0)
    end, frame_records = press_on(rig)
    assert end == "depth cap"
    assert frame_records[-1]["depth_mm"] == pytest.approx(7.0)


def test_the_box_ends_a_press_as_the_cap_does():
    rig = Spring(0.8, clearance_mm=11.0, search_mm=12.0)
    floor = rig.config["pose"]["box_m"][2][0] = rig.surface_m - 0.004
    end, frame_records = press_on(rig)
    assert end == "depth cap"
    assert rig.surface_m - 1e-3 * frame_records[-1]["depth_mm"] >= floor


@pytest.mark.parametrize("N_per_mm", [0.8, 2.0])
@pytest.mark.parametrize(
    "felt",
    [
        lambda force_N: force_N if force_N < 1.5 else 0.05,  # its bridge is unplugged
        lambda force_N: min(force_N, 2.2),  # it sticks, or saturates
        lambda force_N: min(force_N, 1.0 - 0.1 * (force_N - 1.0)),  # it drifts away
        lambda force_N: force_N if force_N < 1.5 else math.nan,
    ],
)
def test_a_load_cell_that_goes_deaf_ends_the_press(felt, N_per_mm):
    rig = Spring(N_per_mm, felt=felt, depth_cap_mm=20.0)
    frame_records: list[dict] = []
    with pytest.raises(Fault) as fault:
        press(rig, CONTACT, frame_records.append, lambda news: None)
    assert fault.value.reason == "load cell deaf"
    assert rig.largest_N <= 2.2 + 2.0 * N_per_mm


def test_a_load_cell_that_goes_deaf_while_the_depth_is_held():
    rig, held = Spring(2.0, hold_frames=1), iter([False] * 7 + [True])
    take_frame = rig.frame

    def frame(settle_s):
        if next(held):
            rig.felt = lambda force_N: 0.05
        return take_frame(settle_s)

    rig.frame = frame
    with pytest.raises(Fault, match="the force falls while the depth grows"):
        press_on(rig)


def test_a_zero_that_moves_in_a_press_spoils_it():
    def felt(force_N):
        return max(force_N, 0.5) if rig.largest_N else force_N

    rig = Spring(2.0, felt=felt)
    with pytest.raises(Fault, match=r"\+0\.500 N from before the press to after it") as fault:
        press_on(rig)
    assert fault.value.reason == "load cell zero"


@pytest.mark.parametrize("since_N", [0.0, 3.0, 8.5])
def test_a_board_that_repeats_its_frame_ends_the_press(since_N):
    rig = Spring(2.0, printed=lambda force_N: str(min(max(rig.largest_N, force_N), since_N)))
    with pytest.raises(Fault) as fault:
        press_on(rig)
    assert fault.value.reason == "board frozen"


def test_no_step_is_taken_that_may_pass_the_soft_limit():
    end, frame_records = press_on(Spring(4.5))
    assert end == "stiff"
    assert max(frame["force_N"] for frame in frame_records) <= 12.0


def test_holds_and_the_way_up():
    _, frame_records = press_on(Spring(2.0, hold_frames=2, unload=True))
    assert phases(frame_records)[2:] == ["press"] * 5 + ["hold"] * 2 + ["unload"] * 4
    assert [f["depth_mm"] for f in frame_records[-4:]] == pytest.approx([4, 3, 2, 1])


def test_a_load_cell_that_has_drifted_stops_before_the_skin_is_touched():
    rig = Spring(2.0, offset_N=-0.4)
    with pytest.raises(Fault, match=r"-0\.400 N with nothing touched") as fault:
        press_on(rig)
    assert fault.value.reason == "load cell zero"
    assert rig.depth_mm == 0.0


def test_where_there_is_no_skin_it_stops():
    with pytest.raises(Fault, match=r"no touch within 9\.0 mm") as fault:
        press_on(Spring(2.0, clearance_mm=50.0))
    assert fault.value.reason == "no touch"
