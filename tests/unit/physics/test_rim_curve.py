"""Rims by their length: corners, smooth curves, motions along the normal, and what is no rim."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.errors import InputError
from eitskin.physics.rim_curve import RimCurve, distance, inside
from eitskin.physics.skin import Skin

L_SHAPE = ((0, 0), (100, 0), (100, 50), (50, 50), (50, 100), (0, 100))
PHI = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False) + 0.003


def ellipse(a, b, count=720):
    angle = 2.0 * np.pi * np.arange(count) / count
    return RimCurve(tuple(zip(a * np.cos(angle), b * np.sin(angle), strict=True)), smooth=True)


def through(points, first=0):
    z = np.roll(points, -first)
    return RimCurve(tuple(zip(z.real.tolist(), z.imag.tolist(), strict=True)), smooth=True)


def half_disc(radius=60.0, count=60, first=0):
    """The upper half, from its right corner, through points of the arc alone."""
    return through(radius * np.exp(1j * np.linspace(0.0, np.pi, count)), first)


def test_a_polygon_is_walked_at_even_speed():
    rim = RimCurve(L_SHAPE)
    assert rim.perimeter_mm == pytest.approx(400.0) and rim.area_mm2 == pytest.approx(7500.0)
    np.testing.assert_allclose(
        rim.corner_phi, 2 * np.pi * np.array([0, 100, 150, 200, 250, 300]) / 400
    )
    places = rim.place(2.0 * np.pi * np.array([0.125, 0.4375, 0.99]))
    np.testing.assert_allclose(places, [50, 75 + 50j, 4j], atol=1e-12)
    np.testing.assert_allclose(
        rim.normal(2.0 * np.pi * np.array([0.125, 0.4375])), [-1j, 1j], atol=1e-12
    )


def test_an_ellipse_has_its_length_and_even_speed():
    from scipy.special import ellipe

    rim = ellipse(80.0, 40.0)
    assert rim.perimeter_mm == pytest.approx(4.0 * 80.0 * ellipe(0.75), rel=1e-12)
    assert rim.area_mm2 == pytest.approx(np.pi * 3200.0, rel=1e-10)
    speed = np.abs(rim.place(PHI, 1)) * 2.0 * np.pi / rim.perimeter_mm
    np.testing.assert_allclose(speed, 1.0, atol=1e-8)


def test_splines_are_imported_where_a_rim_is_drawn_alone():
    program = "import sys, eitskin.physics.skin; sys.exit('scipy.interpolate' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.parametrize("first", [0, 23, 59])
def test_a_half_disc_has_its_area_length_and_two_corners(first):
    rim = half_disc(count=120, first=first)
    assert rim.area_mm2 == pytest.approx(1800.0 * np.pi, rel=1e-9)
    assert rim.perimeter_mm == pytest.approx(60.0 * np.pi + 120.0, rel=1e-9)
    assert rim.place(np.zeros(1))[0] == pytest.approx(rim.points[0], abs=1e-8)
    np.testing.assert_allclose(np.sort(rim.place(rim.corner_phi).real), [-60.0, 60.0], atol=1e-8)
    speed = np.abs(rim.place(PHI, 1)) * 2.0 * np.pi / rim.perimeter_mm
    np.testing.assert_allclose(speed, 1.0, atol=1e-8)
    flat = rim.place(PHI).imag < 1e-9
    np.testing.assert_array_equal(rim.is_bent(PHI), ~flat)
    away = np.abs(np.abs(rim.place(PHI)) - 60.0)
    assert away[~flat].max() < 1e-7


def test_a_rim_goes_to_other_processes():
    rim = half_disc()
    again = pickle.loads(pickle.dumps((rim.perimeter_mm, rim)))[1]
    np.testing.assert_array_equal(again.place(PHI), rim.place(PHI))


def test_a_drop_has_one_corner():
    angle = np.linspace(-0.75 * np.pi, 0.75 * np.pi, 80)
    arc = 30.0 * np.exp(1j * angle)
    tangent = -30.0 * np.sqrt(2.0)
    sides = tangent + (arc[0] - tangent) * np.arange(20)[:, None] / 20
    rim = through(np.concatenate([sides.ravel(), arc, sides.ravel()[:0:-1].conj()]), first=11)
    np.testing.assert_allclose(rim.place(rim.corner_phi), [tangent], atol=1e-9)


@pytest.mark.parametrize(
    "rim",
    [
        ellipse(80.0, 20.0, 40),
        ellipse(80.0, 40.0, 20),
        ellipse(60.0, 60.0, 20),
        ellipse(60.0, 60.0, 9),
        RimCurve((*ellipse(80.0, 20.0).points_mm[::18], (79.99, -1.0)), smooth=True),
    ],
    ids=["4:1", "2:1", "20 points", "9 points", "uneven"],
)
def test_a_curve_drawn_by_few_points_has_no_corners(rim):
    assert len(rim.corner_phi) == 0


def test_a_wavy_rim_has_no_corners():
    angle = 2.0 * np.pi * np.arange(40) / 40
    radius = 60.0 * (1.0 + 0.12 * np.cos(2 * angle) + 0.08 * np.cos(3 * angle - 1.0))
    assert len(through(radius * np.exp(1j * angle)).corner_phi) == 0


def test_a_notch_in_a_stadium_has_its_four_corners():
    arc = 40.0 * np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 41))
    top = np.linspace(60.0, 10.0, 16)[1:] + 40j
    notch = np.array([10 + 25j, -10 + 25j, -10 + 40j])
    left = np.linspace(-10.0, -60.0, 16)[1:] + 40j
    low = np.linspace(-60.0, 60.0, 38)[1:-1] - 40j
    rim = through(np.concatenate([60 + arc, top, notch, left, -60 - arc[1:], low]), first=5)
    np.testing.assert_allclose(
        rim.place(rim.corner_phi), [10 + 40j, 10 + 25j, -10 + 25j, -10 + 40j], atol=1e-9
    )
    expected = 120.0 * 80.0 + np.pi * 1600.0 - 300.0
    assert rim.area_mm2 == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    "rim",
    [RimCurve(L_SHAPE), ellipse(60.0, 45.0), half_disc(first=11)],
    ids=["L", "ellipse", "half disc"],
)
@pytest.mark.parametrize("order", [0, 1])
def test_derivatives_are_those_of_differences(rim, order):
    step = 1e-6
    for curve in (rim.place, rim.mitred_normal):
        difference = (curve(PHI + step, order) - curve(PHI - step, order)) / (2.0 * step)
        np.testing.assert_allclose(curve(PHI, order + 1), difference, atol=2e-4, rtol=1e-5)


@pytest.mark.parametrize("rim", [RimCurve(L_SHAPE), half_disc(first=11)], ids=["L", "half disc"])
def test_sides_that_move_outwards_still_meet(rim):
    for corner in rim.corner_phi:
        before, after = rim.mitred_normal(np.array([corner - 1e-9, corner + 1e-9]))
        assert abs(before - after) < 1e-6
        assert abs(before) == pytest.approx(np.sqrt(2.0), rel=1e-6)


@given(x=st.floats(-20, 120), y=st.floats(-20, 120))
def test_a_place_is_within_or_at_its_distance(x, y):
    rim = RimCurve(L_SHAPE)
    is_within = (0 < x < 100 and 0 < y < 50) or (0 < x < 50 and 0 < y < 100)
    z = np.array([complex(x, y)])
    away = distance(rim.points, z)[0]
    if away > 1e-9:
        assert inside(rim.points, z)[0] == is_within
    phi, nearest = rim.nearest(z)
    assert nearest[0] == pytest.approx(away, abs=1e-9)
    assert abs(rim.place(phi)[0] - z[0]) == pytest.approx(away, abs=1e-9)


def test_its_centre_lies_in_the_middle_of_a_strip():
    strip = RimCurve(((0, 0), (1000, 0), (1000, 100), (0, 100)))
    assert abs(strip.centre - (500 + 50j)) < 20.0


def outline(**words):
    keys = ("radius_mm", "thickness_mm", "conductivity_S_per_m", "electrode_deg")
    keys += ("electrode_width_mm", "contact_impedivity_ohm_m2", "current_A", "contrast_per_N")
    return Skin.from_metadata({**dict.fromkeys(keys), "outline": words}).outline


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ({"corners_mm": [[0, 0], [50, 50], [50, 0], [0, 50]]}, "meet"),
        ({"corners_mm": [[0, 0], [0, 50], [50, 50], [50, 0]]}, "clockwise"),
        ({"corners_mm": [[0, 0], [50, 0], [50, 0], [50, 50]]}, "twice in a row"),
        ({"corners_mm": [[0, 0], [50, 0], [50, 50], [0, 0]]}, "twice in a row"),
        ({"corners_mm": [[0, 0], [50, 0]]}, "3 or more"),
        ({"corners_mm": [[0, 0], [50, 0], [50, float("nan")]]}, "places"),
        ({"corners_mm": [[0, 0], [50, 0], ["50", 50]]}, "places"),
        ({"corners_mm": [[np.cos(t), np.sin(t)] for t in np.linspace(0, 6, 99)]}, "smooth"),
        ({"corners_mm": [[0, 0], [50, 0], [100, 0]]}, "on a line"),
        ({"corners_mm": [[0, 0], [50, 0], [50, 50]], "smooth": "yes"}, "true or false"),
        ({"corners_mm": [[0, 0], [50, 0], [50, 50]], "holes": []}, "keys"),
        ({"shape": "rectangle", "width_mm": 100}, "height_mm"),
        ({"shape": "rectangle", "width_mm": 100, "height_mm": -70}, "height_mm"),
        ({"shape": "hand", "width_mm": 100, "height_mm": 70}, "rectangle"),
        ({"shape": "rectangle", "width_mm": "100", "height_mm": 70}, "height_mm"),
        ({}, "none"),
    ],
)
def test_what_is_no_rim_is_one_message(words, found):
    with pytest.raises(InputError, match="outline") as refusal:
        outline(**words)
    assert found in str(refusal.value)


def test_a_rectangle_begins_at_its_lower_left_corner_and_is_written_by_its_corners():
    rim = outline(shape="rectangle", width_mm=100, height_mm=70)
    assert rim.points_mm[0] == (-50.0, -35.0)
    again = outline(**{"corners_mm": [list(corner) for corner in rim.points_mm]})
    assert again == rim
