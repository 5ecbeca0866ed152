"""Finite elements of any outline against discs, formulae, mirror images and finer ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import iv

from eitskin.physics.forward import channel_values
from witness import disc
from witness.boundary import Disc
from witness.curves import OutlineShape, Shape
from witness.outline_cases import (
    BUILDERS,
    CONCEALING,
    ELECTRODES,
    INSIDE,
    NAMES,
    OUTLINES,
    adjacent_channels,
    outline_case,
    sized_outline,
)
from witness.outline_skin import FINE, Body, InnerElectrode, OutlineSkin, RimElectrode, Touch
from witness.outlines import ellipse, flat_disc, polygon, spline
from witness.triangles import Sizes

QUICK = replace(FINE, order=4, end=1e-3, slope=1.0)
R_MM, WIDTH_MM, Z, SIGMA, THICK_MM = 70.0, 5.0, 5e-4, 0.5, 3.0
CHANNELS = adjacent_channels()


def rms(values) -> float:
    return float(np.sqrt((np.asarray(values) ** 2).mean()))


def skin(outline, shares, fineness=QUICK, inner=()) -> OutlineSkin:
    at_rim = [RimElectrode(float(share), WIDTH_MM, Z) for share in shares]
    return OutlineSkin(outline, [*at_rim, *inner], SIGMA, THICK_MM, fineness)


def rectangle(left, right, height) -> np.ndarray:
    return np.array([[left, 0.0], [right, 0.0], [right, height], [left, height]])


def disc_readings(shares, touch) -> tuple[np.ndarray, np.ndarray]:
    """(M,), (M,): the series' untouched readings and the change by a touch."""
    body = disc.Body(Shape(R_MM), 360.0 * shares, np.full(len(shares), WIDTH_MM), disc.Nodes(96))
    contact = body.contact(np.full(len(shares), 1e3 * Z * SIGMA / R_MM))
    readings = []
    for touches in ([], [touch]):
        place = body.place([Disc(t.x_mm, t.y_mm, t.radius_mm) for t in touches])
        admittance = place.admittance(contact, [t.contrast for t in touches])
        impedance = np.linalg.inv(SIGMA * THICK_MM * 1e-3 * admittance + 1.0)
        source, sink, plus, minus = CHANNELS.T
        driven = impedance[plus] - impedance[minus]
        rows = np.arange(len(CHANNELS))
        readings.append(driven[rows, source] - driven[rows, sink])
    return readings[0], readings[1] - readings[0]


@pytest.mark.parametrize(
    ("fineness", "untouched_limit", "touch_limit"),
    [(QUICK, 3e-6, 5e-6), pytest.param(FINE, 1e-8, 3e-6, marks=pytest.mark.long)],
)
def test_a_disc_is_the_series(fineness, untouched_limit, touch_limit):
    shares = 0.03 + np.arange(ELECTRODES) / ELECTRODES
    touch = Touch(50.0, 10.0, 7.5, 2.0)
    body = skin(ellipse(R_MM, R_MM), shares, fineness)
    untouched, changes = body.changes(CHANNELS, [touch])
    wanted, wanted_change = disc_readings(shares, touch)
    assert rms(untouched - wanted) < untouched_limit * np.median(np.abs(wanted))
    assert rms(changes[0] - wanted_change) < touch_limit * rms(wanted_change)
    np.testing.assert_allclose(body.readings(CHANNELS, [touch]), untouched + changes[0], rtol=1e-9)


def test_current_from_the_middle_to_the_rim():
    """An electrode of radius a in the middle of a disc, the rim all electrode: u is of I0 within a,
    of a logarithm outside."""
    radius_mm, siemens = 6.0, SIGMA * THICK_MM * 1e-3
    rim = RimElectrode(0.0, 2.0 * np.pi * R_MM, Z)
    middle = InnerElectrode(0.0, 0.0, radius_mm, Z)
    body = OutlineSkin(ellipse(R_MM, R_MM), [rim, middle], SIGMA, THICK_MM, QUICK)
    a = 1e-3 * radius_mm / np.sqrt(Z * siemens)
    spreading = (np.log(R_MM / radius_mm) + iv(0, a) / (a * iv(1, a))) / (2.0 * np.pi * siemens)
    through_rim = Z / (2.0 * np.pi * R_MM * 1e-3 * THICK_MM * 1e-3)
    reading = body.readings(np.array([[0, 1, 0, 1]]))
    assert reading == pytest.approx(spreading + through_rim, rel=1e-6)


def test_a_touch_cut_by_the_rim_is_half_of_one_across_a_mirror():
    """A rectangle and its image driven alike: no current crosses the mirror, on which a disc is
    centred."""
    height, right = 60.0, 50.0
    lengths = np.array([20.0, 75.0, 130.0])  # along the rim, from the mirror's lower end
    touch = Touch(0.0, 25.0, 6.0, 2.0)
    inner = [InnerElectrode(side * 30.0, 45.0, 4.0, Z) for side in (1, -1)]
    perimeter = 2.0 * (height + right)
    half = skin(polygon(rectangle(0.0, right, height)), lengths / perimeter, inner=inner[:1])
    around = np.concatenate([right + lengths, right - lengths]) / (perimeter + 2.0 * right) % 1.0
    whole = skin(polygon(rectangle(-right, right, height)), around, inner=inner)
    channels = np.array([[0, 1, 2, 3], [2, 3, 0, 1], [0, 2, 1, 3]])
    right_of, left_of = np.array([0, 1, 2, 6]), np.array([3, 4, 5, 7])
    for touches in ([], [touch]):
        reading = half.readings(channels, touches)
        alike = np.zeros(len(channels))
        for driven in (right_of, left_of):
            pairs = np.column_stack([driven[channels[:, :2]], right_of[channels[:, 2:]]])
            alike += whole.readings(pairs, touches)
        np.testing.assert_allclose(reading, alike, rtol=3e-6)
        assert reading[0] == pytest.approx(reading[1], rel=1e-9)


def test_reciprocity_and_no_dependence_on_the_mesh():
    case = outline_case("L")
    touches = case.touches[2:]
    meshed = [case.skin(fineness=QUICK), case.skin(fineness=replace(QUICK, order=5, rim=0.02))]
    (coarse, coarse_change), (fine, fine_change) = (s.changes(CHANNELS, touches) for s in meshed)
    assert rms(coarse - fine) < 3e-6 * np.median(np.abs(fine))
    for change, wanted in zip(coarse_change, fine_change, strict=True):
        assert rms(change - wanted) < 1e-5 * rms(wanted)
    forward, reverse = (
        meshed[0].readings(c, touches) for c in (CHANNELS, CHANNELS[:, [2, 3, 0, 1]])
    )
    np.testing.assert_allclose(reverse, forward, atol=1e-9 * np.abs(forward).max())


def test_touches_that_cross_each_other_corners_and_electrodes():
    """A triangle turned, and read from another corner on, reads the same."""
    corners = np.array([[0.0, 0.0], [60.0, 0.0], [20.0, 40.0]])
    touches = [
        Touch(58.0, 1.0, 5.0, 2.0),
        Touch(52.0, 1.0, 4.0, -0.5),
        Touch(20.0, 20.0, 21.0, 1.0),
    ]
    shares = np.array([0.05, 0.3, 0.48, 0.8])
    channels = np.array([[0, 1, 2, 3], [0, 2, 1, 3]])
    base = polygon(corners)
    turn = np.exp(0.7j)
    places = (corners @ [1.0, 1j]) * turn
    turned = polygon(np.roll(np.column_stack([places.real, places.imag]), -1, axis=0))
    spots = [complex(t.x_mm, t.y_mm) * turn for t in touches]
    turned_touches = [
        Touch(z.real, z.imag, t.radius_mm, t.contrast) for z, t in zip(spots, touches, strict=True)
    ]
    wanted = skin(base, shares).readings(channels, touches)
    readings = skin(turned, shares - base.ends[1]).readings(channels, turned_touches)
    np.testing.assert_allclose(readings, wanted, rtol=2e-5)


def test_outlines_are_as_long_as_they_are():
    points = R_MM * np.exp(2j * np.pi * np.arange(40) / 40)
    circles = [
        ellipse(R_MM, R_MM),
        spline(np.column_stack([points.real, points.imag])),
        polygon(rectangle(0.0, 30.0, 20.0)),
        flat_disc(R_MM, 0.5 * R_MM),
    ]
    arc = R_MM * (4.0 * np.pi / 3.0 + np.sqrt(3.0))
    lengths = [2.0 * np.pi * R_MM, 2.0 * np.pi * R_MM, 100.0, arc]
    for outline, length in zip(circles, lengths, strict=True):
        assert outline.perimeter_mm == pytest.approx(length, rel=1e-5)
        place = outline.place(np.linspace(0.0, 1.0, 20001))
        steps = np.sort(np.abs(np.diff(place)))  # two may go round corners
        assert steps[4:] == pytest.approx(outline.perimeter_mm / 20000, rel=1e-3)
    assert [len(outline.corners) for outline in circles] == [0, 0, 4, 2]
    assert circles[2].angles == pytest.approx(np.full(4, 0.5 * np.pi))


def test_cases_are_what_they_say():
    assert len(OUTLINES) == 12 and len(INSIDE) == 3
    assert {definition["kind"] for definition, _ in OUTLINES.values()} == set(BUILDERS)
    for name in NAMES:
        case = outline_case(name)
        assert len(case.electrodes) == ELECTRODES and len(case.touches) == 4


def test_refuses_what_is_not_on_the_skin():
    square = rectangle(0.0, 50.0, 50.0)
    with pytest.raises(ValueError, match="anticlockwise"):
        polygon(square[::-1])
    with pytest.raises(ValueError, match="inner electrode 0"):
        skin(polygon(square), [0.1], inner=[InnerElectrode(48.0, 25.0, 4.0, Z)])
    with pytest.raises(ValueError, match="circle 0"):
        skin(polygon(square), [0.1, 0.4]).readings(CHANNELS[:1] % 2, [Touch(60.0, 25.0, 4.0, 1.0)])


def test_a_round_outline_is_a_disc_whatever_solves_it():
    deg, width = 7.0 + 22.5 * np.arange(16), np.full(16, WIDTH_MM)
    flat = Body(OutlineShape(R_MM, outline=ellipse(R_MM, R_MM)), deg, width)
    series = disc.Body(Shape(R_MM), deg, width, disc.Nodes(96))
    length = np.full(16, 1e3 * Z * SIGMA / R_MM)
    touch = Disc(50.0, 10.0, 7.5)
    readings = [
        channel_values(
            np.linalg.inv(place.admittance(body.contact(length), contrast) + 1.0), CHANNELS
        )
        for body in (flat, series)
        for place, contrast in ((body.place(()), ()), (body.place((touch,)), (2.0,)))
    ]
    untouched, touched, wanted, wanted_touched = readings
    assert rms(untouched - wanted) < 1e-5 * np.median(np.abs(wanted))
    change = wanted_touched - wanted
    assert rms(touched - untouched - change) < 3e-5 * rms(change)


def test_harmonics_of_a_round_outline_are_those_of_a_disc():
    harmonics = {0: 0.02 + 0j, 2: 0.05j, 5: 0.01 - 0.02j}
    phi = np.linspace(0.0, 2.0 * np.pi, 50)
    flat = OutlineShape(R_MM, harmonics, outline=ellipse(R_MM, R_MM))
    np.testing.assert_allclose(flat.rim(phi), Shape(R_MM, harmonics).rim(phi), atol=1e-9)
    with pytest.raises(ValueError, match="corners"):
        OutlineShape(R_MM, harmonics, outline=polygon(rectangle(0.0, 50.0, 30.0))).rim(phi)


@pytest.mark.parametrize("name", CONCEALING)
def test_an_outline_for_effects_has_the_area_of_a_disc_and_its_middle_at_the_origin(name):
    outline, stated = sized_outline(name, R_MM)
    assert outline.area_mm2 == pytest.approx(np.pi * R_MM**2, rel=1e-3)
    assert stated.perimeter_mm == pytest.approx(outline.perimeter_mm, rel=1e-8)
    share = np.arange(1000) / 1000
    assert abs(outline.place(share).mean()) < 0.2
    apart = np.abs(stated.place(2.0 * np.pi * share) - outline.place(share))
    assert apart.max() < 1e-4
    assert outline.depth(0.0) > 10.0 and outline.depth(3.0 * R_MM) < 0.0
    assert outline.depth(outline.place(np.array([0.3]))[0]) == pytest.approx(0.0, abs=0.05)


def test_sizes_without_idle_points_are_the_same():
    rng = np.random.default_rng(3)
    points = rng.standard_normal(300) + 1j * rng.standard_normal(300)
    sizes = Sizes(points, rng.uniform(0.01, 0.6, 300), 0.5, 0.7)
    places = rng.standard_normal(500) + 1j * rng.standard_normal(500)
    np.testing.assert_allclose(sizes.reduced()(places), sizes(places), rtol=1e-12)
    assert len(sizes.reduced().points) < 150
