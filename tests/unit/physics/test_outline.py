from dataclasses import replace

import numpy as np
import pytest

from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry, even_angles
from eitskin.physics.outline import CIRCLE_TOLERANCE, described, not_simulated, refuse, rim_angles
from eitskin.physics.skin import Skin

ANGLES = tuple(even_angles(16).tolist())
TURN = np.exp(2j * np.pi * np.arange(360) / 360)


def skin(**known):
    return Skin(80.0, 3.0, 0.5, ANGLES, 5.0, 2e-3, 1e-3, 0.5, **known)


def corners(places):
    return tuple((z.real, z.imag) for z in np.asarray(places))


def turned(places, degrees=0.0, shift=0.0):
    return corners(np.exp(1j * np.radians(degrees)) * np.asarray(places) + shift)


def rectangle(width, height):
    low, high = -width - 1j * height, width + 1j * height
    return [low, -low.conjugate(), high, -high.conjugate()]


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0])
@pytest.mark.parametrize("shift", [0.0, 20.0 - 7.0j])
def test_a_rectangle_is_one_wherever_it_lies(degrees, shift):
    said = described(np.array(turned(rectangle(60, 40), degrees, shift)), " mm")
    assert said in ("a rectangle of 120 x 80 mm", "a rectangle of 80 x 120 mm")
    assert described(np.array(turned(rectangle(50, 50), degrees, shift))) is not None


@pytest.mark.parametrize("amplitude", [0.0, 0.8 * CIRCLE_TOLERANCE, 1.3 * CIRCLE_TOLERANCE])
@pytest.mark.parametrize("shift", [0.0, 100.0 + 3.0j])
def test_a_rim_near_a_circle_is_a_disc_as_far_as_domain_shape_goes(amplitude, shift):
    rim = 80.0 * TURN * (1.0 + amplitude * np.real(TURN**3))
    said = described(np.array(turned(rim, 0.0, shift)), " mm")
    assert (said is None) == (amplitude <= CIRCLE_TOLERANCE)
    assert said is None or said.startswith("an outline of 360 corners, ")


def test_a_triangle_is_told_by_its_corners_and_size():
    said = described(np.array([(0.0, 0.0), (100.0, 0.0), (0.0, 50.0)]), " mm")
    assert said.startswith("an outline of 3 corners, 100 x 50 mm, up to ")


@pytest.mark.parametrize("word", ["disc", "Disk ", "circle"])
def test_a_word_for_a_disc_is_one(word):
    assert not_simulated(skin(outline=word)) is None
    refuse(skin(outline=word))


def test_any_other_word_is_none():
    assert not_simulated(skin(outline="a hand")) == ("skin.outline", "a hand")


def test_electrodes_on_the_rim_are_where_their_angles_say_and_others_inside_or_told():
    on = 80.0 * np.exp(1j * np.radians(ANGLES))
    assert not_simulated(skin(electrode_xy_mm=corners(on))) is None
    assert np.allclose(rim_angles(np.array(corners(on))), ANGLES)
    inner = on.copy()
    inner[[3, 7]] *= 0.4
    within = skin(electrode_xy_mm=corners(inner))
    assert not_simulated(within) is None
    assert Geometry.from_skin(within).inner.tolist() == [3, 7]
    assert np.allclose(Geometry.from_skin(within).inner_place, inner[[3, 7]])
    beyond = on.copy()
    beyond[[3, 7]] *= 1.4
    for told in (skin(electrode_xy_mm=corners(beyond)), replace(within, radius_mm=None)):
        place, found = not_simulated(told)
        assert place == "skin.electrode_xy_mm"
        assert found.startswith("electrode 3 and 1 more of 16 off the rim, at ")


def test_nothing_is_simulated_of_what_is_no_disc():
    square = skin(outline=corners(rectangle(50, 50)))
    with pytest.raises(
        InputError, match="found a rectangle of 100 x 100 mm, as a bare list, expected a disc"
    ):
        Geometry.from_skin(square)
    assert Geometry.from_skin(skin()).radius_mm == 80.0


@pytest.mark.parametrize("key", ["outline", "electrode_xy_mm"])
def test_what_is_said_of_the_shape_comes_back_from_a_file(key):
    told = skin(**{key: corners(rectangle(60, 40))})
    assert Skin.from_metadata(told.metadata()) == told
    assert all(isinstance(place, list) for place in told.metadata()[key])
    assert key not in skin().metadata()


@pytest.mark.parametrize("value", [[], "", 3, [[0, 0], [1, 1]], [[0, 0], [1, 1], [2]], [[0, "a"]]])
def test_a_shape_that_is_none_is_refused(value):
    with pytest.raises(InputError, match=r"skin\.outline"):
        Skin.from_metadata(skin().metadata() | {"outline": value})
