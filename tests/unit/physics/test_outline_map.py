"""The forward model on outlines that are no discs: closed forms, derivatives, clipped touches."""

import numpy as np
import pytest
from scipy.special import ellipj, ellipk, hyp2f1

from eitskin.errors import InputError
from eitskin.physics.conformal import DiscMap
from eitskin.physics.forward import Forward, channel_values, disc_map
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.touch import Touch

CHANNELS = channel_table(16, "adjacent", "adjacent")


def rectangle(width, height):
    x, y = 0.5 * width, 0.5 * height
    return RimCurve(((-x, -y), (x, -y), (x, y), (-x, y)))


def skin(rim, width_mm=5.0, n=16, first=0.5, **values):
    angles = 360.0 * (np.arange(n) + first) / n
    return Geometry(
        rim.perimeter_mm / (2.0 * np.pi), 3.0, 0.5, angles, width_mm, 1e-3, outline=rim, **values
    )


@pytest.mark.parametrize("parameter", [0.05, 0.5, 0.9])
def test_point_electrodes_on_a_rectangle_are_those_of_elliptic_functions(parameter):
    """w = sn(z) takes the rectangle with corners +-K, +-K + i K' to the upper half plane, in which
    the potential at w of a current at v is -ln|w - v| / pi."""
    k, k_prime = ellipk(parameter), ellipk(1.0 - parameter)
    scale = 50.0 / k
    rim = rectangle(100.0, scale * k_prime)
    geometry = skin(rim, width_mm=0.0, first=0.43)
    z = geometry.rim(np.radians(geometry.electrode_deg)) / scale + 0.5j * k_prime
    real = ellipj(z.real, parameter)[:3]
    imaginary = ellipj(z.imag, 1.0 - parameter)[:3]
    (s, c, d), (s1, c1, d1) = real, imaginary
    w = (s * d1 + 1j * c * d * s1 * c1) / (c1**2 + parameter * s**2 * s1**2)
    with np.errstate(divide="ignore"):
        potential = -np.log(np.abs(w[:, None] - w)) / np.pi * geometry.sheet_resistance_ohm
    source, sink, plus, minus = CHANNELS.T
    expected = potential[plus, source] - potential[plus, sink]
    expected -= potential[minus, source] - potential[minus, sink]
    read = Forward(geometry).voltages(CHANNELS)
    np.testing.assert_allclose(read, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("sides", [3, 5, 6])
def test_a_regular_polygon_is_mapped_as_schwarz_and_christoffel_do(sides):
    theta = np.linspace(0.05, 6.2, 40)
    zeta = np.exp(1j * theta)
    node, weight = np.polynomial.legendre.leggauss(400)
    along = 0.5 * (1.0 + node)
    place = zeta * (0.5 * weight @ (1.0 - np.outer(along, zeta) ** sides) ** (-2.0 / sides))
    corner = float(hyp2f1(1.0 / sides, 2.0 / sides, 1.0 + 1.0 / sides, 1.0))
    corners = 50.0 * np.exp(2j * np.pi * np.arange(sides) / sides)
    rim = RimCurve(tuple(zip(corners.real, corners.imag, strict=True)))
    mapped = disc_map(skin(rim, width_mm=0.0, n=3, first=0.31))(50.0 * place / corner)
    # Both are maps onto the disc; what takes one to the other is a Moebius transformation.
    ratios = [
        (a - b) * (c - d) / ((a - c) * (b - d))
        for a, b, c, d in (mapped[[0, 9, 17, 30]], zeta[[0, 9, 17, 30]])
    ]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-6)
    np.testing.assert_allclose(np.abs(mapped), 1.0, atol=1e-7)


def test_a_half_disc_is_a_disc_that_is_its_own_mirror_image():
    """Electrodes on the arc and a touch, and the same with all of them mirrored on a disc."""
    arc = 60.0 * np.exp(1j * np.linspace(0.0, np.pi, 201))
    half = RimCurve(tuple(zip(arc.real, arc.imag, strict=True)), smooth=True)
    deg = np.linspace(8.0, 172.0, 16)
    along = np.degrees(60.0 * np.radians(deg) * 2.0 * np.pi / half.perimeter_mm)
    radius = half.perimeter_mm / (2.0 * np.pi)
    halved = Forward(Geometry(radius, 3.0, 0.5, along, 5.0, 1e-3, outline=half))
    whole = Forward(Geometry(60.0, 3.0, 0.5, np.append(deg, -deg), 5.0, 1e-3))
    touches = [Touch(20.0, 25.0, 6.0, 1.5), Touch(20.0, -25.0, 6.0, 1.5)]
    for count in (0, 1):
        mirrored = whole.transfer_impedance(touches[: 2 * count])
        expected = channel_values(mirrored[:16, :16] + mirrored[:16, 16:], CHANNELS)
        read = halved.voltages(CHANNELS, touches[:count])
        np.testing.assert_allclose(read, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_an_ellipse_as_an_outline_is_a_stretched_disc():
    """The stretched disc's electrodes span other widths of their own rim: points."""
    count = 720
    angle = 2.0 * np.pi * np.arange(count) / count
    rim = RimCurve(tuple(zip(80 * np.cos(angle), 40 * np.sin(angle), strict=True)), smooth=True)
    outlined = skin(rim, width_mm=0.0, first=0.2)
    places = outlined.rim(np.radians(outlined.electrode_deg))
    phi = np.degrees(np.angle(places.real / 80.0 + 1j * places.imag / 40.0))
    disc = Geometry(40.0, 3.0, 0.5, phi, 0.0, 1e-3, stretch_x=2.0)
    np.testing.assert_allclose(
        Forward(outlined).voltages(CHANNELS), Forward(disc).voltages(CHANNELS), rtol=1e-7
    )
    touch = [Touch(30.0, 10.0, 6.0, 1.5)]
    np.testing.assert_allclose(
        Forward(outlined).voltages(CHANNELS, touch),
        Forward(disc).voltages(CHANNELS, touch),
        rtol=1e-6,
    )


def flat_disc():
    """Cut at y = -36, from a point on its arc."""
    arc = 60.0 * np.exp(1j * np.linspace(-np.arcsin(0.6), np.pi + np.arcsin(0.6), 181))
    return RimCurve(tuple(zip(np.roll(arc.real, -31), np.roll(arc.imag, -31), strict=True)), True)


@pytest.mark.parametrize("anisotropy", [1.0, 1.3])
def test_a_map_is_one_on_a_rim_with_corners_beside_curves(anisotropy):
    """Also between the points that it is fitted to."""
    geometry = skin(flat_disc(), first=0.4, anisotropy_ratio=anisotropy)
    rim = geometry.rim(np.linspace(0.0, 2.0 * np.pi, 5001) + 1e-4)
    np.testing.assert_allclose(np.abs(disc_map(geometry)(geometry.unfold(rim))), 1.0, atol=1e-8)


@pytest.mark.parametrize("rim", [rectangle(120.0, 80.0), flat_disc()], ids=["rectangle", "flat"])
@pytest.mark.parametrize(
    "name", ["electrode_deg[3]", "shape_cos[2]", "stretch_x", "anisotropy_ratio", "x_mm[0]"]
)
def test_derivatives_are_those_of_differences(name, rim):
    start = skin(rim, shape_cos={2: 0.01}, anisotropy_ratio=1.1, first=0.4)
    touch = Touch(20.0, -10.0, 5.0, 1.0)
    exact = Forward(start).derivatives([touch], [name])[name]
    kind, _, index = name.rstrip("]").partition("[")

    def impedance(step):
        if kind == "x_mm":
            return Forward(start).transfer_impedance([Touch(20.0 + step, -10.0, 5.0, 1.0)])
        value = getattr(start, kind)
        if kind == "electrode_deg":
            value = value + step * (np.arange(16) == int(index))
        elif kind == "shape_cos":
            value = {2: 0.01 + step}
        else:
            value = value + step
        return Forward(start.with_values(**{kind: value})).transfer_impedance([touch])

    step = 1e-4
    difference = (impedance(step) - impedance(-step)) / (2.0 * step)
    # By channels, from which a map's choice of its centre cancels.
    exact, difference = (channel_values(slope, CHANNELS) for slope in (exact, difference))
    np.testing.assert_allclose(exact, difference, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_a_touch_is_the_same_wherever_a_symmetric_skin_is_touched():
    """A square's eight places, clipped at a corner in four points too."""
    forward = Forward(skin(rectangle(100.0, 100.0), first=0.5))
    for x, y in ((44.0, 20.0), (48.0, 20.0), (47.0, 46.4), (49.0, 48.0)):
        sizes = []
        for place in ((x, y), (-x, y), (y, x), (-y, -x)):
            change = forward.place(*place, 4.0).channel_change(CHANNELS, [1.0])[0]
            sizes.append(np.sort(np.abs(change)))
        np.testing.assert_allclose(
            sizes, np.broadcast_to(sizes[0], np.shape(sizes)), rtol=2e-6, atol=1e-9
        )


def test_what_lies_beyond_a_side_does_not_count():
    """A touch whose part on the skin is the same, of two that reach beyond the rim differently:
    half discs about the same place of a longer rectangle's mirror plane."""
    forward = Forward(skin(rectangle(100.0, 100.0), first=0.5))
    centred = forward.place(50.0, 12.0, 5.0).channel_change(CHANNELS, [1.0])[0]
    doubled = Forward(skin(rectangle(100.0, 100.0), first=0.5))
    assert np.abs(centred).max() > 0
    with pytest.raises(InputError, match="on the skin"):
        doubled.place(60.0, 12.0, 5.0)
    assert forward.meets([(54.0, 12.0, 5.0), (56.0, 12.0, 5.0)]).tolist() == [True, False]


def test_a_strip_too_narrow_for_its_electrodes_is_refused_by_name():
    strip = rectangle(3000.0, 100.0)
    with pytest.raises(InputError, match="no narrow tips"):
        Forward(skin(strip, first=0.37))


@pytest.mark.long
def test_a_notch_narrower_than_a_right_angle_is_mapped():
    """A palm with a thumb; also between the points that the map is fitted to."""
    thumb = ((80, 15), (108.8, 36.6), (101.6, 46.2), (80, 30))
    geometry = skin(RimCurve(((0, 0), (80, 0), *thumb, (80, 70), (0, 70))), n=6)
    rim = geometry.rim(np.linspace(0.0, 2.0 * np.pi, 5001))
    np.testing.assert_allclose(np.abs(disc_map(geometry)(rim)), 1.0, atol=1e-7)


@pytest.mark.long
def test_a_slit_that_is_too_narrow_is_refused_by_name():
    """Its map would be one on the points that it is fitted to, and nowhere between them."""
    slit = ((0, 0), (100, 0), (100, 60), (52, 60), (50, 20), (48, 60), (0, 60))
    with pytest.raises(InputError, match="too rough for a conformal map"):
        Forward(skin(RimCurve(slit), n=6))


def test_a_map_without_poles_is_that_of_a_disc():
    rim = 80.0 * np.exp(2j * np.pi * np.arange(256) / 256)
    assert len(DiscMap(rim).series.poles) == 0
