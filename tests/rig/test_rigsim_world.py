import numpy as np
import pandas as pd
import pytest

from eitskin.data import board
from eitskin.errors import InputError
from eitskin.simulate.readings import simulate
from rigsim import eit
from rigsim.world import World
from rigsim_process import CENTRE, SURFACE_Z_M, configuration

PAPER, STEP_V = board.read("circular-16"), 2.2 / 1024


def made(tmp_path, **changed) -> World:
    config = configuration(tmp_path)["world"]
    return World({**config, **changed}, PAPER.channels, seed=1)


def at(x_mm: float, y_mm: float, depth_mm: float) -> np.ndarray:
    pose = np.array(CENTRE)
    pose[:3] += [1e-3 * x_mm, 1e-3 * y_mm, 0.0]
    pose[2] = SURFACE_Z_M - 1e-3 * depth_mm
    return pose


def go_down(world: World, x_mm: float, y_mm: float, depth_mm: float, t: float = 10.0) -> float:
    """Down to a depth in steps of 8 ms at 10 mm/s; the time at the end."""
    world.follow(at(x_mm, y_mm, -0.1), t)
    for depth in np.arange(0.0, depth_mm, 0.08):
        t += 0.008
        world.follow(at(x_mm, y_mm, depth), t)
    t += 0.008
    world.follow(at(x_mm, y_mm, depth_mm), t)
    return t


@pytest.mark.parametrize(
    ("effect", "is_unchanged"),
    [
        ({"name": "channel-gain", "parameters": {"gain": {"sd": 0.02}}}, True),
        ({"name": "conductivity-drift", "parameters": {"per_minute": 0.01}}, False),
    ],
)
def test_an_untouched_skin_changes_only_where_an_effect_says_so(tmp_path, effect, is_unchanged):
    world = made(tmp_path, effects=[effect])
    reference = world.voltages(0.0, 0.3, None)
    t = go_down(world, 20.0, -10.0, 4.0) + 5.0
    touched = world.voltages(t, 0.3, world.press_since(t, t + 0.3))
    later = world.voltages(600.0, 0.3, None)
    assert np.array_equal(reference, later) == is_unchanged
    assert not np.allclose(touched, later)
    np.testing.assert_allclose(later, made(tmp_path, effects=[effect]).voltages(600.0, 0.3, None))


def states(world: World, t: float, force: float, x_mm: float, y_mm: float) -> pd.DataFrame:
    row = {"time_s": t, "touch": True, "x_mm": x_mm, "y_mm": y_mm, "force_N": force}
    return pd.DataFrame([{**row, "probe_mm": world.probe_mm()}])


@pytest.mark.parametrize("probe_mm", [7.0, 10.0, 15.0])
def test_the_force_is_a_power_of_the_depth_that_grows_with_the_probe(tmp_path, probe_mm):
    world = made(tmp_path, probe_mm=probe_mm)
    go_down(world, 20.0, -10.0, 4.0)
    np.testing.assert_allclose(world.force_N, 0.55 * probe_mm / 10.0 * 4.0**1.5)
    assert world.contacts == 1 and world.touching
    assert world.follow(at(20.0, -10.0, -1.0), 20.0) == "released"
    assert world.force_N == 0.0 and not world.touching
    np.testing.assert_allclose(world.largest_N, 0.55 * probe_mm / 10.0 * 4.0**1.5)


def test_the_stiffness_is_scattered_smoothly_over_the_skin(tmp_path):
    world = made(tmp_path, stiffness={"N_per_mm": 0.55, "exponent": 1.5, "scatter": 0.1})
    rng = np.random.default_rng(0)
    places = rng.uniform(-60.0, 60.0, (300, 2))
    log = np.log([world.stiffness(x, y, 10.0) / 0.55 for x, y in places])
    assert 0.04 < log.std() < 0.2
    nearby = np.log([world.stiffness(x + 1.0, y, 10.0) / 0.55 for x, y in places])
    assert np.abs(nearby - log).max() < 0.03


def test_the_skin_may_be_turned_and_moved_under_the_robot(tmp_path):
    place = {"x_m": 0.1, "y_m": 0.2, "surface_z_m": 0.0, "angle_deg": 90.0}
    world = made(tmp_path, place=place)
    along_base_y = np.array([0.1, 0.23, 0.0, 0.0, 3.142, 0.0])
    np.testing.assert_allclose(world.on_skin_mm(along_base_y), (30.0, 0.0), atol=1e-9)


@pytest.mark.parametrize(
    "effects", [[], [{"name": "channel-gain", "parameters": {"gain": {"sd": 0.02}}}]]
)
def test_a_held_press_reads_as_eitskin_simulates_it(tmp_path, effects):
    world = made(tmp_path, effects=effects)
    t = go_down(world, 20.0, -10.0, 4.0) + 5.0
    press = world.press_since(t, t + 0.3)
    voltages = world.voltages(t, 0.3, press)
    state = states(world, t, world.force_N, 20.0, -10.0)
    expected = simulate(
        state, np.zeros(1), world.skin, world.channels, world.effects, "train", 0.3
    )[0]
    np.testing.assert_allclose(voltages, expected, rtol=1e-9)
    untouched = simulate(
        state.assign(touch=False), -np.ones(1), world.skin, world.channels, world.effects, "train"
    )[0]
    assert np.abs(voltages - untouched).max() > 0.01 * np.median(np.abs(untouched))


def test_a_line_says_the_simulated_readings_to_the_converters_step(tmp_path):
    world = made(tmp_path)
    t = go_down(world, 0.0, 40.0, 3.0) + 1.0
    reading = np.abs(world.voltages(t, 0.3, world.press_since(t, t + 0.3)))
    line = eit.text(eit.values(world.readings(reading), PAPER), PAPER)
    assert line.endswith(b", \n") and line.count(b", ") == 256
    printed = np.array([float(value) for value in line.decode().split(", ")[:-1]])
    for source, _, plus, _ in world.channels.tolist():
        assert plus not in (source - 1, source, source + 1)
    driven = [16 * k + (k + j) % 16 for k in range(16) for j in (-1, 0, 1)]
    assert not printed[driven].any()
    measured_mask = printed[16 * world.channels[:, 0] + world.channels[:, 2]]
    assert np.abs(measured_mask - reading).max() <= STEP_V / 2 + 5e-5 + 1e-12
    codes = measured_mask / STEP_V
    assert np.abs(codes - np.round(codes)).max() * STEP_V <= 5e-5 + 1e-12


@pytest.mark.parametrize(
    "changed",
    [
        {"electrodes": 8, "driven": "ignored", "voltage": "signed", "range": [-3000, 3000]},
        {"electrodes": 13, "line": {"begin": "F%d,", "number": "%d", "between": ",", "end": "\n"}},
        {"drive": "opposite", "step": 0.5, "unit": "ohm", "remarks": "#.*"},
    ],
)
def test_a_line_of_any_board_says_what_was_measured(changed):
    description = {
        **{"electrodes": 16, "drive": "adjacent", "measurement": "adjacent"},
        "line": {"begin": "magnitudes: ", "number": "%13.4f", "between": ",", "end": " *%02X\r\n"},
        **{"factor": 0.001, "voltage": "magnitude", "range": [0, 3000], "ceiling": 3000},
        **{"baud": 9600, "period_s": 1.0, "frame_s": 1.0},
    }
    eit_board = board.described("any", description | changed, "any.yaml")
    readings = np.random.default_rng(1).uniform(-2.0, 2.0, len(eit_board.channels))
    read = eit_board.parse(eit.text(eit.values(readings, eit_board), eit_board))
    expected = readings if eit_board.voltage == "signed" else np.abs(readings)
    np.testing.assert_allclose(read, expected, atol=1e-3)


def test_readings_above_the_converters_range_saturate():
    assert eit.values(np.full(208, 2.0), PAPER).max() == 1.1


def test_every_drive_sees_the_force_of_its_own_moment(tmp_path):
    world = made(tmp_path)
    begin = go_down(world, 20.0, -10.0, 2.0)
    for k in range(1, 51):
        world.follow(at(20.0, -10.0, 2.0 + 0.04 * k), begin + 0.006 * k)
    press = world.press_since(begin, begin + 0.3)
    voltages = world.voltages(begin, 0.3, press)
    for drive in (0, 8, 15):
        force = press.at(np.array([begin + 0.3 * drive / 16]))[0]
        state = states(world, begin, force, 20.0, -10.0)
        simulated = simulate(state, np.zeros(1), world.skin, world.channels, [], "train")[0]
        driven_channels = world.channels[:, 0] == drive
        np.testing.assert_allclose(voltages[driven_channels], simulated[driven_channels], rtol=1e-7)
    assert press.at(np.array([begin]))[0] < press.at(np.array([begin + 0.28]))[0]


def test_memory_is_of_the_force_that_was_there_and_not_of_frames_alone(tmp_path):
    relaxing = [{"name": "relaxation", "parameters": {"fraction": 0.3, "tau_s": 5.0}}]
    world = made(tmp_path, effects=relaxing)
    end = go_down(world, 20.0, -10.0, 4.0)
    time_s = end + 7.0
    voltages = world.voltages(time_s, 0.3, world.press_since(time_s, time_s + 0.3))
    # The same press as eitskin has it where frames come as often as the world's cycles.
    times, force = np.array(world._knots).T
    dense = pd.concat(
        [states(world, t, f, 20.0, -10.0) for t, f in zip(times[1:-1], force[1:-1], strict=True)]
        + [states(world, time_s, world.force_N, 20.0, -10.0)],
        ignore_index=True,
    )
    expected = simulate(
        dense,
        np.zeros(len(dense)),
        world.skin,
        world.channels,
        world.effects,
        "train",
        force_max_N=10.0,
    )
    changed = np.abs(expected[-1] - expected[-2])
    assert changed.max() > 1e-3 * np.median(np.abs(voltages))
    np.testing.assert_allclose(voltages, expected[-1], atol=2e-3 * changed.max(), rtol=0.0)


def test_the_probe_is_what_the_file_says(tmp_path):
    file = tmp_path / "probe"
    world = made(tmp_path, probe_file=str(file))
    assert world.probe_mm() == 10.0
    file.write_text("15.0\n", encoding="utf-8")
    assert world.probe_mm() == 15.0


def test_effects_of_the_clock_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"frame-skew.*one channel after another"):
        made(tmp_path, effects=[{"name": "frame-skew", "parameters": {"fraction": 0.1}}])


@pytest.mark.parametrize(
    ("direction", "leans"),
    [([0, 3.142, 0], False), ([2.2214, 2.2214, 0], False), ([0, 2.9, 0], True)],
)
def test_a_tool_that_does_not_point_down_is_seen(tmp_path, direction, leans):
    assert made(tmp_path).tool_leans(np.array([0, 0, 0, *direction])) == leans
