"""The witness's slab against analytic solutions, finer ones, and the others where they agree."""

from functools import cache

import numpy as np
import pytest

from eitskin.physics.forward import channel_values
from eitskin.physics.protocol import channel_table
from witness import disc, slab
from witness.boundary import Disc, Radial
from witness.cases import draw
from witness.curves import Shape
from witness.deep import DeepBody, Depth
from witness.elements import Fineness
from witness.generators import GENERATORS
from witness.slab import Grain, Layers, Solid
from witness.world import World

N, R_MM, WIDTH_MM, DEEP_MM = 16, 80.0, 6.0, 3.0
DEG, WIDTHS = 22.5 * np.arange(N), np.full(N, WIDTH_MM)
CHANNELS = channel_table(N)
TOUCH, CONTRAST = Disc(60.0, 10.0, 7.5), 3.0
SHEET = Solid(DEEP_MM, DEEP_MM, 0.5 * DEEP_MM)
HALF_DENT = Solid(DEEP_MM, DEEP_MM, 0.5 * DEEP_MM, 0.5)
HALF_HIGH = Solid(DEEP_MM, 0.5 * DEEP_MM, 0.5 * DEEP_MM)


def volts(skin, discs, contrasts) -> np.ndarray:
    contact = skin.contact(np.full(N, 1.0 / R_MM))
    admittance = skin.place(discs).admittance(contact, contrasts)
    return channel_values(np.linalg.inv(0.5 * (admittance + admittance.T) + 1.0), CHANNELS)


@cache
def solved(solid: Solid, *fine) -> tuple[np.ndarray, np.ndarray]:
    """Untouched and touched."""
    skin = slab.Body(Shape(R_MM), DEG, WIDTHS, solid, 5.0, *fine)
    return volts(skin, [], []), volts(skin, [TOUCH], [CONTRAST])


def error(mine, theirs) -> tuple[float, float]:
    """Largest difference over the median |v|, and of a touch over the touch."""
    deviation = max(np.abs(a - b).max() for a, b in zip(mine, theirs, strict=True))
    touch = theirs[1] - theirs[0]
    of_touch = np.abs(mine[1] - mine[0] - touch).max() / np.abs(touch).max()
    return deviation / np.median(np.abs(theirs[0])), of_touch


def test_layers_are_cosines():
    """k = n pi over the depth, and the mean of 1 + c in a part of the depth is 1 + c share."""
    layers = Layers(HALF_DENT, R_MM, Grain(5, 1))
    n = np.arange(6)
    k = np.sqrt(layers.eigen[:6]) * DEEP_MM / R_MM
    assert k == pytest.approx(np.pi * n, rel=1e-4, abs=1e-6)
    mass, rise = layers.within(0.5, 1.0)
    assert mass[0, 0] == pytest.approx(0.5, abs=1e-12)
    # int over the upper half of 2 cos^2, and of sqrt 2 cos pi z.
    assert np.diag(mass)[:6] == pytest.approx(0.5, abs=1e-5)
    assert abs(mass[0, 1]) == pytest.approx(np.sqrt(2.0) / np.pi, abs=1e-6)
    full_mass, _ = layers.within(0.0, 1.0)
    assert full_mass == pytest.approx(np.eye(len(full_mass)), abs=1e-8)
    assert rise[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.long
def test_full_depth_is_the_sheet():
    skin = disc.Body(Shape(R_MM), DEG, WIDTHS)
    sheet = volts(skin, [], []), volts(skin, [TOUCH], [CONTRAST])
    untouched_error, touch = error(solved(SHEET), sheet)
    assert untouched_error < 1e-4 and touch < 1e-4
    # The same as the limit of dents that leave next to nothing below them.
    nearly = Solid(DEEP_MM, DEEP_MM, 0.5 * DEEP_MM, 0.999)
    untouched_error, touch = error(solved(nearly), sheet)
    assert untouched_error < 5e-3 and touch < 5e-3


@pytest.mark.long
def test_part_high_electrodes_are_the_series():
    """DeepBody solves them by Bessel functions; a sheet is off by more than 1e-2."""
    skin = DeepBody(Shape(R_MM), DEG, WIDTHS, Depth(DEEP_MM, 0.5 * DEEP_MM, 0.5 * DEEP_MM), 5.0)
    series = volts(skin, [], []), volts(skin, [TOUCH], [CONTRAST])
    untouched_error, touch = error(solved(HALF_HIGH), series)
    assert untouched_error < 1e-4 and touch < 2e-4
    assert error(solved(SHEET), series)[0] > 1e-2


@pytest.mark.long
def test_own_error():
    """Dents of half the depth, against elements finer in depth and in plane: under a third of the
    least noise of the slab's cases, and of a touch under 3e-4."""
    finer = Fineness(rim=0.06, circle=0.18, end=0.004)
    coarse, in_depth, in_plane = (
        error(solved(HALF_DENT, *a), solved(HALF_DENT, *b))
        for a, b in (
            ((None, Grain(2)), (None, Grain(4, 1))),
            ((), (None, Grain(4, 1))),
            ((None, Grain(2)), (finer, Grain(2))),
        )
    )
    assert in_depth[0] + in_plane[0] < GENERATORS["slab"].least_level / 3.0
    assert in_depth[1] + in_plane[1] < 3e-4
    assert in_depth[1] < 0.5 * coarse[1]


def test_shallow_dents_show():
    """A dent of twice the contrast and half the depth is not the sheet's, by more than 1 %, and
    weaker: current does not reach down at its edge."""
    skin = slab.Body(Shape(R_MM), DEG, WIDTHS, HALF_DENT, 5.0)
    contact = skin.contact(np.full(N, 1.0 / R_MM))
    place = skin.place([TOUCH])
    small, large = (place.admittance(contact, [c]) for c in (0.0, 2.0 * CONTRAST))
    plain = solved(SHEET)
    impedance = np.linalg.inv(0.5 * (large + large.T) + 1.0)
    change = channel_values(impedance, CHANNELS) - plain[0]
    largest_change = np.abs(plain[1] - plain[0]).max()
    assert 0.8 < np.abs(change).max() / largest_change < 0.99
    assert np.abs(small - skin.place([]).admittance(contact, [])).max() < 1e-4


def test_reciprocity_and_no_leak():
    skin = slab.Body(Shape(R_MM), DEG, WIDTHS, Solid(DEEP_MM, 1.5, 1.0, 0.4), 5.0)
    place = skin.place([TOUCH])
    matrix = place.admittance(skin.contact(np.full(N, 1.0 / R_MM)), [CONTRAST])
    assert np.abs(matrix - matrix.T).max() < 1e-8 * np.abs(matrix).max()
    assert np.abs(matrix.sum(axis=1)).max() < 1e-8 * np.abs(matrix).max()


def test_refuses_what_it_does_not_know():
    skin = slab.Body(Shape(R_MM), DEG, WIDTHS, SHEET)
    with pytest.raises(ValueError, match="one touch"):
        skin.place([TOUCH, Disc(0.0, 0.0, 7.0)])
    with pytest.raises(ValueError, match="sharp"):
        leak = Radial.leaking(7.0, 0.0, 1e-3, 1.0)
        skin.place([TOUCH]).admittance(skin.contact(np.ones(N)), [0.0], leak)
    with pytest.raises(ValueError, match="round rim"):
        slab.Body(Shape(R_MM, {2: 0.1}), DEG, WIDTHS, SHEET)


@pytest.mark.long
def test_a_case_is_the_boundarys():
    mine = draw("single:electrode-width", 3, 20, "slab")
    theirs = draw("single:electrode-width", 3, 20)
    assert mine.effects == theirs.effects and mine.states.equals(theirs.states)
    assert mine.level >= GENERATORS["slab"].least_level
    for a, b in ((mine.clean, theirs.clean), (mine.query_clean, theirs.query_clean)):
        assert 0.0 < np.abs(a - b).max() < 1e-4 * np.median(np.abs(theirs.clean[0]))
    world = World(mine.true, CHANNELS, mine.metadata["frame_s"], generator="slab")
    with pytest.raises(ValueError, match="law of sheets"):
        world.readings(mine.states[:2], [{"name": "third-dimension"}])


@pytest.mark.long
def test_shallow_dents_are_drawn():
    case = draw("outside:shallow-dent", 1, 20, "slab")
    assert case.outside["law"] == "shallow-dent" and case.effects == []
    assert 0.3 <= case.outside["parameters"]["amount"] <= 0.7
    untouched = ~case.states["touch"].to_numpy(bool)
    assert np.abs(case.clean[untouched] - case.clean[0]).max() < 1e-12
