"""Physics kept for the last block: each law does what its equation says, and nothing at 0."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from witness import unseen
from witness.boundary import Resolution
from witness.cases import draw
from witness.outside import OUTSIDE, Scene
from witness.schedule import Keep, recording_frames
from witness.strengths import DRAWN
from witness.world import Touches, World

CHANNELS = np.array([[0, 1, 2, 3], [0, 1, 3, 4], [1, 2, 3, 4], [1, 2, 4, 0]])
WORLD = SimpleNamespace(channels=CHANNELS, frame_s=0.4, skin=SimpleNamespace(radius_mm=50.0))
FREE = (-20.0, 10.0, 8.0)


def rows(press, force, time_s=None, contrast=0.5) -> Touches:
    """What five electrodes' skin meets: z 1, sigma 1, touches of 5 mm at the centre."""
    press, force = np.array(press), np.array(force, float)
    touched, size = press >= 0, len(press)
    time = np.arange(size, dtype=float) if time_s is None else np.array(time_s, float)
    return Touches(
        touched=touched,
        place=np.zeros(size, complex),
        radius_mm=np.full(size, 5.0),
        contrast=np.where(touched, contrast, 0.0),
        force=force,
        minutes=time / 60.0,
        press=press,
        z=np.ones((size, 5)),
        sigma=np.ones(size),
        siemens=np.zeros(size),
    )


def test_charge_fades_after_a_drive():
    law = unseen.ChargeUp(0.5, readings=1.0 / np.log(2.0), reference_V=4.0)
    read = law.converted(np.ones((1, 4)), None, WORLD)
    # At the last reading electrode 0 gave current two readings ago: a quarter of 0.5 x 4 V is left.
    assert read[0] == pytest.approx([1.0, 1.0, 1.0, 1.0 - 0.5])


def test_the_front_dries_inwards_as_the_root_of_time():
    law = unseen.DryingFront(0.4, depth_mm=10.0, end_s=100.0)
    met = rows([-1, -1, 0, 0], [0, 0, 1, 2], [0.0, 100.0, 55.0, 60.0])
    law.touch(met, WORLD)
    assert met.sigma == pytest.approx(0.6)
    discs, contrasts = zip(*(met.inclusions[row][0] for row in range(4)), strict=True)
    assert met.sigma * (1.0 + np.array(contrasts)) == pytest.approx(1.0)
    depth = 50.0 - np.array([disc.radius_mm for disc in discs])
    assert depth == pytest.approx(10.0 * np.sqrt([0.2, 1.0, 0.64, 0.64]))


def test_the_rim_peels_with_the_largest_force_of_a_press():
    law = unseen.Peeling(4.0, electrode=3, turn=1, threshold_N=1.0, step_N=2.0)
    met = rows([0, 0, 0, -1, 1], [0.5, 4.0, 2.0, 0.0, 2.0])
    law.touch(met, WORLD)
    assert met.z[0] == pytest.approx(1.0)
    assert met.z[1] == pytest.approx([1.0, 1.0, 1.0, 5.0, 3.0])  # (4 - 1) / 2: one and a half
    assert met.z[2] == pytest.approx(met.z[1])
    assert met.z[3] == pytest.approx(1.0)
    assert met.z[4] == pytest.approx([1.0, 1.0, 1.0, 3.0, 1.0])
    next_rows = rows([0], [4.0])
    replace(law, turn=-1).touch(next_rows, WORLD)
    assert next_rows.z[0] == pytest.approx([1.0, 1.0, 3.0, 5.0, 1.0])


def test_the_bubble_moves_with_each_press():
    law = unseen.Bubble(0.9, *FREE[:2], reach_mm=6.0, radius_mm=2.0, seed=7)
    met = rows([-1, 3, 3, -1, 4, -1], [0, 1, 2, 0, 1, 0])
    law.touch(met, WORLD)
    discs = [met.inclusions[row][0][0] for row in range(6)]
    assert discs[1] == discs[2] == discs[3] and discs[4] == discs[5]
    assert len({discs[0], discs[1], discs[4]}) == 3
    later = rows([-1, 5], [0, 1])
    law.touch(later, WORLD)
    assert later.inclusions[0][0][0] == discs[5]  # where the press before left it
    places = np.array([law.place(press) for press in range(200)]) - complex(*FREE[:2])
    assert np.abs(places).max() <= 6.0 and np.abs(places).max() > 5.0
    assert met.inclusions[0][0][1] == -0.9


def test_leads_couple_when_the_drive_is_switched():
    rng = np.random.default_rng(3)
    conductance = rng.uniform(1e-3, 2e-3, (5, 5))
    conductance = np.triu(conductance, 1) + np.triu(conductance, 1).T
    admittance = (np.diag(conductance.sum(axis=1)) - conductance)[None]
    law = unseen.LeadCoupling(0.2, readings=2.0)
    met = SimpleNamespace(siemens=np.zeros(1))
    read = law.pairs(np.zeros((1, 4)), admittance, met, WORLD)[0]
    above = {}
    for source, sink in ((0, 1), (1, 2)):
        level = np.linalg.pinv(admittance[0]) @ (np.eye(5)[source] - np.eye(5)[sink])
        above[source] = level - level[sink]
    for k, (source, _, plus, minus) in enumerate(CHANNELS):
        step = above[source] - above[1 - source]  # the other drive came before, round the frame
        coupled = {i: 0.1 * (step[(i - 1) % 5] + step[(i + 1) % 5]) for i in (plus, minus)}
        fade = np.exp(-(k % 2) / 2.0)
        assert read[k] == pytest.approx(fade * (coupled[plus] - coupled[minus]))


def test_the_lamp_warms_exponentially():
    law = unseen.WarmingPatch(0.8, *FREE, tau_s=10.0)
    met = rows([-1, -1, -1], [0, 0, 0], [0.0, 10.0, 1e4])
    law.touch(met, WORLD)
    contrasts = [met.inclusions[row][0][1] for row in range(3)]
    assert contrasts == pytest.approx([0.0, 0.8 * (1.0 - np.exp(-1.0)), 0.8])
    assert met.inclusions[0][0][0].radius_mm == FREE[2]


def test_the_range_follows_the_drive_before():
    law = unseen.SteppedGain(0.5, level_V=3.0)
    volt = np.array([[1.0, 2.0, 4.0, 3.0], [1.0, -5.0, 2.0, 1.0]])
    read = law.converted(volt, None, WORLD)
    assert read[0] == pytest.approx([1.0, 2.0, 6.0, 4.5])
    assert read[1] == pytest.approx([1.5, -7.5, 2.0, 1.0])


def test_the_probe_slips_once_it_gets_lighter():
    law = unseen.ProbeSlip(2.0, seed=1)
    met = rows([-1, 0, 0, 0, 0, 1, 1], [0, 1, 3, 2, 2.5, 2, 4])
    law.touch(met, WORLD)
    assert np.abs(met.place) == pytest.approx([0, 0, 0, 2, 2, 0, 0])
    assert met.place[3] == met.place[4]
    next_rows = rows([0, 0, 2, 2], [3, 2, 3, 2])
    law.touch(next_rows, WORLD)
    assert next_rows.place[1] == met.place[3] and next_rows.place[3] != met.place[3]


def test_ripple_multiplies_at_each_channels_moment():
    law = unseen.SupplyRipple(0.1, frequency_Hz=2.5, phase=np.pi / 2)
    read = law.converted(np.full((2, 4), 2.0), rows([-1, -1], [0, 0], [0.0, 0.1]), WORLD)
    # Channels are read 0.1 s apart: a quarter of the period.
    assert read[0] == pytest.approx([2.2, 2.0, 1.8, 2.0])
    assert read[1] == pytest.approx([2.0, 1.8, 2.0, 2.2])


def test_popcorn_noise_has_two_levels():
    law = unseen.PopcornNoise(0.5, measure=3, dwell_s=2.0, reference_V=4.0, seed=5)
    time = np.arange(0.0, 4000.0, 0.05)
    met = rows(np.full(len(time), -1), np.zeros(len(time)), time)
    read = law.converted(np.zeros((len(time), 4)), met, WORLD)
    assert set(np.unique(read[:, [1, 2]])) == {0.0, 2.0} and not read[:, [0, 3]].any()
    jumps = np.count_nonzero(np.diff(read[:, 1]))
    assert 4000.0 / jumps == pytest.approx(2.0, rel=0.1)
    part = law.converted(np.zeros((9, 4)), rows(np.full(9, -1), np.zeros(9), time[400:409]), WORLD)
    assert np.array_equal(part, read[400:409])  # a query goes on where the recording is


def test_half_cells_creep():
    law = unseen.HalfCellDrift(0.5, tau_s=10.0, reference_V=2.0, ends=(1.0, 0.0, 3.0, -1.0, 0.5))
    read = law.converted(np.zeros((2, 4)), rows([-1, -1], [0, 0], [0.0, 10.0]), WORLD)
    assert not read[0].any()
    expected = (1.0 - np.exp(-1.0)) * np.array([4.0, -1.5, -1.5, -0.5])
    assert read[1] == pytest.approx(expected)


def test_the_filter_smooths_over_frames():
    read = unseen.AveragingFilter(0.5).converted(np.array([[1.0], [3.0], [3.0]]), None, WORLD)
    assert read.ravel() == pytest.approx([1.0, 2.0, 2.5])


def test_gel_piles_up_as_much_as_the_touch_displaces():
    met = rows([-1, 0], [0, 2], contrast=0.3)
    unseen.PileUp(0.5).touch(met, WORLD)
    assert list(met.layers) == [1]
    radii, relative = met.layers[1]
    area = np.diff(radii**2, prepend=0.0)
    assert relative[0] == 1.3
    assert area[1] * (1.0 - relative[1]) == pytest.approx(0.5 * area[0] * (relative[0] - 1.0))


@pytest.fixture(scope="module")
def small():
    """A world with a few states that keep off FREE, what it reads of them, and the laws' scene."""
    skin = Skin(60.0, 3.0, 0.5, tuple(22.5 * np.arange(16)), 6.0, 2e-3, 1e-3, 0.3)
    rng = np.random.default_rng(11)
    states = recording_frames(rng, skin.radius_mm, 0.3, Keep((FREE,), 1.5), 20)
    world = World(skin, channel_table(16), 0.3)
    plain = world.readings(states, [])
    presses = states["contact"].dropna().unique().astype(int)
    end = float(states["time_s"].iloc[-1])
    return world, states, plain, Scene(16, presses, end, skin.radius_mm, FREE, plain[0])


@pytest.mark.parametrize("name", unseen.UNSEEN)
def test_every_law_starts_from_nothing(name, small):
    world, states, plain, scene = small
    drawn = unseen.UNSEEN[name].draw(np.random.default_rng(2), scene)
    assert drawn.amount == drawn.max_amount
    median = np.median(np.abs(plain[0]))
    none, some = (
        world.readings(states, [], replace(drawn, amount=a * drawn.max_amount)) for a in (0.0, 0.1)
    )
    assert np.abs(none - plain).max() < 1e-9 * median
    assert np.abs(some - plain).max() > 1e-5 * median


@pytest.mark.parametrize("name", ["drying-front", "bubble", "pile-up"])
def test_inclusions_are_resolved(name, small):
    world, states, _, scene = small
    states = states.iloc[:8]
    drawn = unseen.UNSEEN[name].draw(np.random.default_rng(4), scene)
    law = replace(drawn, amount=0.3 * drawn.max_amount)
    fine = World(world.skin, world.channels, 0.3, resolution=Resolution(640, 24, 26.0))
    readings, exact = world.readings(states, [], law), fine.readings(states, [], law)
    assert np.abs(readings - exact).max() < 1e-5 * np.median(np.abs(exact))


def test_kept_apart_from_calibration():
    assert not set(unseen.UNSEEN) & (set(OUTSIDE) | set(DRAWN))


@pytest.mark.parametrize("name", ["bubble", "supply-ripple"])
def test_drawn_as_cases(name):
    case = draw(f"outside:{name}", 3, frames=50)
    assert case.outside["law"] == name and case.effects == []
    assert 18.0 < case.outside["snr"] < 105.0
    centre_distance = np.hypot(case.states["x_mm"], case.states["y_mm"])
    assert np.isfinite(centre_distance[case.states["touch"]]).all()
