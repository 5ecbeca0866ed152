"""Electrodes inside a skin, against closed forms, symmetry, limits and finite elements."""

import numpy as np
import pytest
from scipy.special import ive

from eitskin.errors import InputError
from eitskin.physics import neumann
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry, Patch, even_angles
from eitskin.physics.protocol import channel_table
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.solver import forward_model
from eitskin.physics.touch import Touch
from witness import outlines
from witness.outline_skin import InnerElectrode, OutlineSkin, RimElectrode
from witness.outline_skin import Touch as WitnessTouch

RADIUS, ON_RIM = 40.0, complex(np.nan)
CHANNELS = channel_table(8)
TOUCHES = [Touch(-12.0, 5.0, 6.0, 2.0), Touch(8.0, -17.0, 4.0, -0.6)]
INSIDE = np.array([*[ON_RIM] * 5, 12.0 + 3.0j, -6.0 - 15.0j, 1.0 + 20.0j])


def geometry(inside=INSIDE, width_mm=5.0, z=2e-3, **values):
    angle = even_angles(len(inside), 10.0)
    return Geometry(
        RADIUS, 3.0, 0.5, angle, width_mm, z, electrode_inside_mm=np.array(inside), **values
    )


def reading(impedance, source, sink, plus, minus):
    return (
        impedance[plus, source]
        - impedance[plus, sink]
        - impedance[minus, source]
        + impedance[minus, sink]
    )


def test_points_are_at_the_neumann_function_of_their_places():
    place = np.array([0.0, 0.3 + 0.2j, -0.5j])
    inside = [ON_RIM, *RADIUS * place, ON_RIM]
    skin = geometry(inside, 0.0)
    relative = Forward(skin).transfer_impedance() / skin.sheet_resistance_ohm
    rim = np.exp(1j * np.radians(skin.electrode_deg[[0, 4]]))
    zeta = np.array([rim[0], *place, rim[1]])
    expected = neumann.potential(zeta[:, None] + 3.0 * np.eye(5), zeta)
    apart = ~np.eye(5, dtype=bool)
    assert np.allclose(relative[apart], expected[apart], atol=1e-12)
    assert np.isnan(relative[~apart]).all()


@pytest.mark.parametrize("z", [1e-5, 2e-3, 1.0])
def test_a_disc_in_the_middle_of_a_disc_is_a_closed_form(z):
    """The current of two alike electrodes opposite on the rim leaves through the middle; the part
    of it that is even round the middle flows as ln r beside an even rim."""
    width = 10.0
    skin = geometry([0.0, ON_RIM], width, z)
    shifted = geometry([6.0, ON_RIM], width, z)
    length2 = 1e-3 * z * 0.5 * 3e-3 * 1e9
    x = 0.5 * width / np.sqrt(length2)
    alone = -np.log(0.5 * width / RADIUS) + ive(0, x) / (x * ive(1, x))
    electrodes = Forward(skin).electrodes
    whole = electrodes.whole[0]
    assert np.isclose(electrodes.matrix[whole, whole], alone / (2.0 * np.pi), rtol=1e-12)
    image = -np.log(1.0 - (6.0 / RADIUS) ** 2)
    electrodes = Forward(shifted).electrodes
    assert np.isclose(electrodes.matrix[whole, whole], (alone + image) / (2.0 * np.pi), rtol=1e-12)


def test_poor_contacts_spread_the_current_evenly():
    width, z = 8.0, 1e3
    electrodes = Forward(geometry([3.0, ON_RIM], width, z)).electrodes
    power = electrodes.inner.self_power(electrodes.geometry)[0]
    drop = z * 0.5 * 3e-3 / (np.pi * (0.5e-3 * width) ** 2)
    even = (0.25 - np.log(0.5 * width)) / (2.0 * np.pi)
    assert np.isclose(power - drop, even, atol=1e-6 * drop + 1e-9)


def test_good_contacts_are_those_of_a_perfect_conductor():
    """Mode m of a perfect disc takes 1 / (2 pi m), in a distance of the root of the contact."""
    for z in (1e-8, 1e-10):
        electrodes = Forward(geometry([3.0, 3.0j, -6.0], 2.0, z)).electrodes
        power = electrodes.inner.self_power(electrodes.geometry)
        order = np.arange(1, electrodes.inner.orders + 1)
        layer = float(electrodes.inner.layer_mm(electrodes.geometry)[0])
        perfect = 0.5 / (np.pi * order)
        assert np.allclose(
            power[1 : len(order) + 1] - perfect, layer / np.pi, rtol=0.02 + 20 * layer
        )


def test_a_mirrored_skin_reads_alike():
    skin = geometry()
    mirrored = geometry(INSIDE.conj()).with_values(electrode_deg=-skin.electrode_deg)
    forward, mirror = Forward(skin), Forward(mirrored)
    touches = [Touch(t.x_mm, -t.y_mm, t.radius_mm, t.contrast) for t in TOUCHES]
    readings = forward.voltages(CHANNELS, TOUCHES)
    assert np.allclose(readings, mirror.voltages(CHANNELS, touches), rtol=1e-9)


def test_electrodes_inside_turn_with_the_skin():
    turn = np.exp(0.7j)
    skin = geometry()
    turned = geometry(INSIDE * turn).with_values(electrode_deg=skin.electrode_deg + np.degrees(0.7))
    readings = [Forward(g).voltages(CHANNELS) for g in (skin, turned)]
    assert np.allclose(*readings, rtol=1e-9)


def test_a_batch_of_touches_is_the_touches_one_by_one():
    forward = Forward(geometry())
    places = [(t.x_mm, t.y_mm, t.radius_mm) for t in TOUCHES] + [
        (12.0, 3.0, 6.0),
        (-20.0, 20.0, 9.0),
    ]
    for modes, (x, y, radius) in zip(forward.places(places), places, strict=True):
        change = modes.channel_change(CHANNELS, [1.5])[0]
        touched = forward.voltages(CHANNELS, [Touch(x, y, radius, 1.5)])
        assert np.allclose(forward.voltages(CHANNELS) + change, touched, rtol=1e-9)


def test_a_touch_all_over_an_electrode_scales_what_is_near_it():
    """A touch that covers a disc in the middle of a disc, in closed form: ln r on both sides."""
    contrast, radius, width, z = 1.5, 15.0, 6.0, 2e-3
    places = [0.0, ON_RIM, ON_RIM]
    skin = geometry(places, width, z)
    forward = Forward(skin)
    change = forward.place(0.0, 0.0, radius).impedance_change([contrast])[0]

    def alone(factor):
        x = 0.5 * width / np.sqrt(z * 0.5 * 3e-3 * factor * 1e6)
        return (-np.log(0.5 * width / radius) + ive(0, x) / (x * ive(1, x))) / (2.0 * np.pi)

    expected = alone(1.0 + contrast) / (1.0 + contrast) - alone(1.0)
    assert np.isclose(change[0, 0] / skin.sheet_resistance_ohm, expected, rtol=1e-5)


def test_points_within_a_touch_are_a_series():
    """Of four points in a disc of factor k in the middle of a disc, by harmonics."""
    factor, radius = 4.0, 12.0
    place = np.array([2.0, -3.0j, -6.0 + 1.0j, 4.0 + 4.0j])
    skin = geometry([*place, ON_RIM, ON_RIM], 0.0)
    touched = Forward(skin).transfer_impedance([Touch(0.0, 0.0, radius, factor - 1.0)])
    x, y = place[:, None] / RADIUS, place / RADIUS
    order = np.arange(1, 80)[:, None, None]
    share = (radius / RADIUS) ** (2 * order)
    rim = (1.0 + share) / (1.0 - share)
    strength = (rim - 1.0 / factor) / (share * (1.0 + factor * rim))
    within = (strength * ((x * y.conj()) ** order).real / order).sum(axis=0)
    log = -np.log(np.abs(x - y) + np.eye(4)) / factor
    expected = skin.sheet_resistance_ohm * (log + within) / (2.0 * np.pi)
    assert np.isclose(reading(touched, 0, 1, 2, 3), reading(expected, 0, 1, 2, 3), rtol=1e-6)


@pytest.mark.parametrize("width_mm", [0.0, 5.0])
def test_derivatives_are_those_of_the_skins_beside_it(width_mm):
    skin = geometry(width_mm=width_mm)
    forward = Forward(skin)
    assert ("electrode_width_mm[6]" in forward.parameters(TOUCHES)) == (width_mm > 0)
    apart = ~np.eye(8, dtype=bool) if width_mm == 0 else np.ones((8, 8), bool)
    for name, field, index, step in (
        ("electrode_x_mm[5]", "electrode_inside_mm", 5, 1e-3),
        ("electrode_y_mm[7]", "electrode_inside_mm", 7, 1e-3j),
        ("electrode_deg[1]", "electrode_deg", 1, 1e-3),
        ("thickness_mm", "thickness_mm", (), 1e-3),
    ):
        slope = forward.derivatives(TOUCHES, [name])[name]
        changed = []
        for sign in (1.0, -1.0):
            value = np.array(getattr(skin, field))
            value[index] += sign * step
            beside = skin.with_values(**{field: value if value.ndim else float(value)})
            changed.append(Forward(beside).transfer_impedance(TOUCHES))
        expected = (changed[0] - changed[1]) / (2.0 * abs(step))
        scale = np.abs(expected[apart]).max()
        assert np.allclose(slope[apart], expected[apart], atol=2e-5 * scale), name


def test_what_is_not_differentiated_is_refused_by_name():
    forward = Forward(geometry())
    with pytest.raises(InputError, match="found stretch_x, expected one of conductivity_S_per_m"):
        forward.derivatives([], ["stretch_x"])
    with pytest.raises(InputError, match="over an electrode inside"):
        forward.derivatives([Touch(12.0, 3.0, 8.0, 1.0)])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"inside": [0.0, 4.0, ON_RIM]}, "electrodes 0 and 1, which overlap"),
        ({"inside": [0.0, 38.0, ON_RIM]}, "electrode 1, 5 mm wide at .38, 0. mm, over the rim"),
        ({"inside": [0.0, 45.0, ON_RIM]}, "electrode 1, 5 mm wide at .45, 0. mm, over the rim"),
        ({"anisotropy_ratio": 1.1}, "anisotropy_ratio: found 1.1, expected 1 beside electrodes"),
        ({"gradient_across": 0.1}, "gradient_across: found 0.1, expected 0 beside electrodes"),
        ({"electrode_height_mm": 1.0}, "electrode_height_mm: found 1, expected none beside"),
    ],
)
def test_what_is_not_modelled_is_refused_in_one_sentence(values, said):
    with pytest.raises(InputError, match=said):
        geometry(**values)


def test_a_touch_across_the_edge_of_an_electrode_is_refused():
    forward = Forward(geometry())
    with pytest.raises(InputError, match=r"found \(15, 3\) mm, radius 3 mm, across electrode 5"):
        forward.place(15.0, 3.0, 3.0)
    with pytest.raises(InputError, match="cut by the rim, over electrode 0"):
        Forward(geometry([33.0, ON_RIM, ON_RIM])).place(33.0, 0.0, 9.0)
    with pytest.raises(InputError, match="over an electrode inside the skin"):
        forward.contact(12.0, 3.0, 8.0)
    patched = geometry(patches=(Patch(13.0, 3.0, 4.0, 2.0),))
    with pytest.raises(InputError, match="over electrode 5"):
        forward_model(patched, "diagnose")


def test_a_patch_beside_electrodes_inside_is_a_touch_there():
    touch = Touch(-12.0, 5.0, 6.0, 2.0)
    patched = forward_model(geometry(patches=(Patch(-12.0, 5.0, 6.0, 3.0),)), "diagnose")
    touched = Forward(geometry()).voltages(CHANNELS, [touch])
    assert np.allclose(patched.voltages(CHANNELS), touched, rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("z", [2e-5, 2e-3])
def test_a_skin_is_that_of_finite_elements(z):
    corners = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]])
    rim = RimCurve(tuple(map(tuple, corners.tolist())))
    share = np.array([0.1, 0.3, 0.55, 0.8])
    place = [15.0 + 12.0j, 30.0 + 24.0j, 46.0 + 30.0j, 47.0 + 12.0j]
    electrodes = [
        *(RimElectrode(s, 5.0, z) for s in share),
        *(InnerElectrode(p.real, p.imag, 2.5, z) for p in place),
    ]
    witness = OutlineSkin(outlines.polygon(corners), electrodes, 0.5, 3.0)
    touches = [WitnessTouch(32.0, 10.0, 4.0, 2.0), WitnessTouch(45.0, 29.0, 7.0, 1.5)]
    untouched, changes = witness.changes(CHANNELS, touches)
    skin = Geometry(
        rim.perimeter_mm / (2.0 * np.pi),
        3.0,
        0.5,
        np.append(360.0 * share, np.zeros(4)),
        5.0,
        z,
        outline=rim,
        electrode_inside_mm=np.array([*[ON_RIM] * 4, *place]),
    )
    forward = Forward(skin)
    error = np.sqrt(np.mean((forward.voltages(CHANNELS) - untouched) ** 2))
    assert error < 1e-5 * np.median(np.abs(untouched))
    for touch, expected in zip(touches, changes, strict=True):
        modes = forward.place(touch.x_mm, touch.y_mm, touch.radius_mm)
        change = modes.channel_change(CHANNELS, [touch.contrast])[0]
        assert np.linalg.norm(change - expected) < 1e-4 * np.linalg.norm(expected)
