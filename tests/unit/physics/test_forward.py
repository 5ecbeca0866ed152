"""The forward model against closed forms, Fourier series, symmetry and its own convergence."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import reference_disc as reference
from benchmark.finite_elements import FiniteElements
from eitskin.errors import InputError
from eitskin.physics.forward import Accuracy, Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.physics.touch import Touch, TouchAccuracy
from symmetric_mesh import symmetric_disc_mesh

CHANNELS = channel_table(16)
ELECTRODES = np.arange(16) * 22.5
RESISTANCE = 1e3 / (0.5 * 3.0)
FINER = Accuracy(24, TouchAccuracy(30, 1e-10, 16, 5e-4), 64)


def skin(width=5.0, z=1e-3, **values):
    return Geometry(80.0, 3.0, 0.5, ELECTRODES, width, z, **values)


def relative(found, expected):
    """Largest deviation over the median size, on channels that have a value."""
    return np.nanmax(np.abs(found - expected)) / np.nanmedian(np.abs(expected))


def test_points_on_the_homogeneous_disc():
    expected = reference.points_homogeneous(np.radians(ELECTRODES)) * RESISTANCE
    found = Forward(skin(0.0, 0.0)).voltages(CHANNELS)
    assert relative(found, channel_values(expected, CHANNELS)) < 1e-12


@pytest.mark.parametrize("factor", [0.2, 10.0])
def test_points_with_a_concentric_inclusion(factor):
    expected = reference.points_concentric(np.radians(ELECTRODES), 0.3, factor) * RESISTANCE
    found = Forward(skin(0.0, 0.0)).voltages(CHANNELS, [Touch(0.0, 0.0, 24.0, factor - 1.0)])
    assert relative(found, channel_values(expected, CHANNELS)) < 1e-7


@pytest.mark.parametrize("centre", [0.3 + 0.2j, -0.72 + 0.5j])
@pytest.mark.parametrize("factor", [0.2, 10.0])
def test_points_with_an_eccentric_inclusion(centre, factor):
    angles = np.radians(ELECTRODES)
    expected = reference.points_eccentric(angles, centre, 0.1, factor) * RESISTANCE
    touch = Touch(80.0 * centre.real, 80.0 * centre.imag, 8.0, factor - 1.0)
    found = Forward(skin(0.0, 0.0)).voltages(CHANNELS, [touch])
    assert relative(found, channel_values(expected, CHANNELS)) < 1e-7


@pytest.mark.parametrize(("width", "z"), [(5.0, 1e-3), (10.0, 1e-2)])
def test_complete_electrodes_against_a_fourier_series(width, z):
    expected = reference.complete_electrodes(16, width / 80.0, z * 0.5 / 0.08)[0] * RESISTANCE
    found = Forward(skin(width, z)).transfer_impedance()
    pairs = np.eye(16) - np.roll(np.eye(16), 1, axis=1)
    assert relative(channel_values(found, CHANNELS), channel_values(expected, CHANNELS)) < 1e-6
    found, expected = pairs @ found @ pairs.T, pairs @ expected @ pairs.T
    assert relative(found, expected) < 1e-4


def test_touched_complete_electrodes_against_a_fourier_series():
    z = 1e-3 * 0.5 / 0.08 * np.ones(16)
    widths = 5.0 / 80.0 * np.ones(16)
    touch = (0.3 + 0.45j, 0.1, 6.0)
    expected = reference.complete_touched(np.radians(ELECTRODES), widths, z, touch)[0] * RESISTANCE
    found = Forward(skin()).voltages(CHANNELS, [Touch(24.0, 36.0, 8.0, 5.0)])
    assert relative(found, channel_values(expected, CHANNELS)) < 1e-5


def test_an_ideal_skin_is_circulant_and_mirror_symmetric():
    impedance = Forward(skin()).transfer_impedance()
    size = np.abs(impedance).max()
    assert np.abs(np.roll(impedance, (1, 1), (0, 1)) - impedance).max() < 1e-10 * size
    assert np.abs(impedance[::-1, ::-1] - impedance).max() < 1e-10 * size


@settings(max_examples=15)
@given(
    r=st.floats(0.0, 0.97),
    phi=st.floats(0.0, 360.0),
    radius=st.floats(2.0, 12.0),
    contrast=st.floats(-0.95, 20.0),
    seed=st.integers(0, 1000),
)
def test_reciprocity_wherever_and_whatever(r, phi, radius, contrast, seed):
    rng = np.random.default_rng(seed)
    geometry = Geometry(
        80.0,
        3.0,
        0.5,
        ELECTRODES + rng.normal(0, 1, 16),
        rng.uniform(3, 8, 16),
        10.0 ** rng.uniform(-4, -2, 16),
        shape_cos={2: rng.normal(0, 0.02), 3: rng.normal(0, 0.02)},
        anisotropy_ratio=1.2,
    )
    place = 76.0 * r * np.exp(1j * np.radians(phi))
    touch = Touch(place.real, place.imag, radius, contrast)
    voltage = Forward(geometry, "train").voltages(CHANNELS, [touch])
    pairs, sign = reciprocal_channels(CHANNELS)
    odd = voltage[pairs[:, 0]] - sign * voltage[pairs[:, 1]]
    assert np.abs(odd).max() < 1e-12 * np.abs(voltage).max()


def test_all_forces_at_a_place_equal_single_solves():
    forward = Forward(skin())
    contrast = np.array([-0.9, -0.2, 0.1, 3.0, 50.0])
    modes = forward.place(30.0, 41.0, 7.5)
    changes = modes.channel_change(CHANNELS, contrast)
    for c, change in zip(contrast, changes, strict=True):
        single = forward.voltages(CHANNELS, [Touch(30.0, 41.0, 7.5, c)])
        assert relative(forward.voltages(CHANNELS) + change, single) < 1e-12
    full = modes.impedance_change(contrast)
    assert np.allclose(channel_values(full, CHANNELS), changes, rtol=0, atol=1e-12)


def test_two_touches_far_apart_almost_add_up():
    """Far apart, two touches change a frame almost by the sum; the rest is their interaction."""
    forward = Forward(skin())
    a, b = Touch(-30.0, 0.0, 5.0, 2.0), Touch(30.0, 5.0, 7.0, -0.5)
    base = forward.voltages(CHANNELS)
    both, alone = (
        forward.voltages(CHANNELS, [a, b]) - base,
        [forward.voltages(CHANNELS, [t]) - base for t in (a, b)],
    )
    interaction = np.linalg.norm(both - sum(alone)) / np.linalg.norm(both)
    assert 1e-5 < interaction < 1e-2


def test_two_touches_against_a_finer_expansion():
    touches = [Touch(10.0, 40.0, 7.5, 5.0), Touch(27.0, 40.0, 7.5, -0.8)]
    found, finer = (Forward(skin(), a).voltages(CHANNELS, touches) for a in ("diagnose", FINER))
    assert relative(found, finer) < 1e-6


@pytest.mark.parametrize(("accuracy", "bound"), [("train", 5e-3), ("diagnose", 5e-4)])
@pytest.mark.parametrize("radius", [7.9, 8.0, 8.1, 8.8])
def test_touches_that_reach_the_rim_or_are_clipped_by_it(accuracy, bound, radius):
    place = 72.0 * np.exp(1j * np.radians(11.25))
    found, finer = (
        Forward(skin(), a).place(place.real, place.imag, radius).channel_change(CHANNELS, [0.5, 9])
        for a in (accuracy, FINER)
    )
    assert np.linalg.norm(found - finer) < bound * np.linalg.norm(finer)


@pytest.mark.parametrize("node", [144, 488])
def test_a_touch_that_the_rim_crosses_where_it_is_looked_for(node):
    """Its centre and its radius are legs of a right triangle whose third side is the rim's radius:
    node 0 of its edge or a neighbour lies on the rim to rounding."""
    small = Geometry(25.0, 3.0, 0.5, ELECTRODES, 0.0, 0.0)
    centre = 24.0 * np.exp(2j * np.pi * node / 512)
    found, near = (
        Forward(small).place(turned.real, turned.imag, 7.0).channel_change(CHANNELS, [0.5])
        for turned in (centre, centre * np.exp(1e-7j))
    )
    assert np.allclose(found, near, rtol=1e-5, atol=1e-6 * np.abs(found).max())


@pytest.mark.parametrize("angle", [0.0, 11.25])
def test_a_touch_whose_centre_is_off_the_skin(angle):
    place = 83.0 * np.exp(1j * np.radians(angle))
    found, finer = (
        Forward(skin(), a).place(place.real, place.imag, 8.0).channel_change(CHANNELS, [0.5, 9])
        for a in ("train", FINER)
    )
    assert np.linalg.norm(found - finer) < 0.02 * np.linalg.norm(finer)
    forward = Forward(skin(), "train")
    assert forward.meets([(87.0, 0.0, 8.0), (89.0, 0.0, 8.0)]).tolist() == [True, False]


def test_anisotropy_is_a_stretched_skin():
    """Conductivity sx : sy^-1 on a disc equals an isotropic disc of stretched coordinates."""
    ratio = 1.3
    points = skin(0.0, 0.0, anisotropy_ratio=ratio)
    stretched = skin(0.0, 0.0, stretch_x=ratio**-0.25, stretch_y=ratio**0.25)
    found, expected = (Forward(g).voltages(CHANNELS) for g in (points, stretched))
    assert relative(found, expected) < 1e-12


def test_a_larger_skin_of_points_reads_the_same():
    """Harmonic 0 of the rim is size; a 2D skin of point electrodes has no length."""
    found = Forward(skin(0.0, 0.0, shape_cos={0: 0.1})).voltages(CHANNELS)
    assert relative(found, Forward(skin(0.0, 0.0)).voltages(CHANNELS)) < 1e-10


def test_sharing_an_outline_changes_nothing():
    first = Forward(skin())
    first.place(20.0, 10.0, 5.0)
    other = skin().with_values(conductivity_S_per_m=0.6)
    shared, own = Forward(other, donor=first), Forward(other)
    assert np.array_equal(shared.transfer_impedance(), own.transfer_impedance())
    assert np.array_equal(shared.place(20.0, 10.0, 5.0).gains, own.place(20.0, 10.0, 5.0).gains)


@pytest.mark.parametrize(
    ("touches", "message"),
    [
        ([(90.0, 0.0, 5.0, 1.0)], "place: found"),
        ([(0.0, 0.0, 0.0, 1.0)], "radius_mm: found 0"),
        ([(0.0, 0.0, 5.0, -1.0)], "contrast: found -1"),
        ([(0.0, 0.0, 5.0, 1.0), (3.0, 0.0, 5.0, 1.0)], "touches apart"),
    ],
)
def test_refuses_touches_that_make_no_sense(touches, message):
    with pytest.raises(InputError, match=message):
        Forward(skin()).transfer_impedance([Touch(*touch) for touch in touches])


def test_refuses_a_contrast_that_leaves_no_conductivity():
    modes = Forward(skin(), "train").place(10.0, 20.0, 5.0)
    with pytest.raises(InputError, match="contrast"):
        modes.channel_change(CHANNELS, [0.5, -1.0])


def test_refuses_to_measure_a_driven_point():
    with pytest.raises(InputError, match="driven point electrode"):
        Forward(skin(0.0, 0.0)).voltages(np.array([[0, 1, 1, 2]]))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"electrode_width_mm": 40.0}, "overlap"),
        ({"contact_impedivity_ohm_m2": 0.0}, "contact_impedivity"),
        ({"contact_impedivity_ohm_m2": 1e-7}, "contact_impedivity"),
        ({"radius_mm": -1.0}, "radius_mm"),
    ],
)
def test_refuses_skins_that_make_no_sense(values, message):
    with pytest.raises(InputError, match=message):
        Forward(skin().with_values(**values))


@pytest.mark.parametrize(("accuracy", "bound"), [("train", 5e-3), ("diagnose", 1e-3)])
def test_a_touch_that_just_reaches_the_rim(accuracy, bound):
    """Both stop short of it, by their rim_gap; the change is linear in the gap that is left."""
    angles, direction = np.radians(ELECTRODES), np.radians(11.25)
    touching = reference.points_touching(angles, direction, 0.1, 5.0)
    change = (touching - reference.points_homogeneous(angles)) * RESISTANCE
    place = 72.0 * np.exp(1j * direction)
    modes = Forward(skin(0.0, 0.0), accuracy).place(place.real, place.imag, 8.0)
    expected = channel_values(change, CHANNELS)
    error = modes.channel_change(CHANNELS, [4.0])[0] - expected
    assert np.linalg.norm(error) < bound * np.linalg.norm(expected)


@pytest.mark.parametrize(
    "values",
    [
        {"shape_cos": {2: 0.04}, "shape_sin": {3: 0.03}},
        {"stretch_x": 1.06, "stretch_y": 0.95},
    ],
)
def test_other_rims_against_finite_elements(values):
    """Complete electrodes and a touch on a skin that is no disc, on a mesh bent to its shape."""
    geometry = skin(5.0, 2e-3, **values)
    unit, electrodes = symmetric_disc_mesh(16, 5.0 / 80.0, 1, 3, rings=(0.25,))
    z = unit.doflocs[0] + 1j * unit.doflocs[1]
    shape = sum(a * np.abs(z) ** 4 * np.cos(k * np.angle(z)) for k, a in geometry.shape_cos.items())
    shape += sum(
        a * np.abs(z) ** 4 * np.sin(k * np.angle(z)) for k, a in geometry.shape_sin.items()
    )
    bent = geometry.stretch(0.08 * z * (1.0 + shape))
    mesh = type(unit)(np.stack([bent.real, bent.imag]), unit.t)
    elements = FiniteElements(mesh, electrodes, contact=2e-3 / 3e-3, order=2)
    ones = np.full(mesh.nelements, 1.5e-3)
    expected = elements.voltages(ones, CHANNELS, 1.0)
    found = Forward(geometry).voltages(CHANNELS)
    assert relative(Forward(skin(5.0, 2e-3)).voltages(CHANNELS), expected) > 0.05
    assert relative(found, expected) < 1e-3


@given(
    beyond=st.floats(-0.95, 0.95),
    angle=st.floats(0.0, 6.3),
    radius=st.floats(1.0, 12.0),
    skin_mm=st.just(80.0),
)
# On a point of the grid in which the crossing is looked for, to the bit.
@example(beyond=-2.0 / 14.0, angle=0.0, radius=14.0, skin_mm=50.0)
@example(beyond=-1.6 / 11.2, angle=0.0, radius=11.2, skin_mm=40.0)
def test_a_clipped_touch_ends_where_its_circle_crosses_the_rim(beyond, angle, radius, skin_mm):
    """Lengths of both arcs, as two circles have them."""
    forward = Forward(Geometry(skin_mm, 3.0, 0.5, ELECTRODES, 5.0, 1e-3), "train")
    away = skin_mm + beyond * radius
    edge = forward.edge(Touch(away * np.cos(angle), away * np.sin(angle), radius))
    assert edge.clipped
    inside = np.arccos((away**2 + radius**2 - skin_mm**2) / (2.0 * away * radius))
    on_rim = np.arccos((away**2 + skin_mm**2 - radius**2) / (2.0 * away * skin_mm))
    assert edge.weight.sum() == pytest.approx(2.0 * inside, rel=1e-9)
    assert edge.rim_weight.sum() == pytest.approx(2.0 * on_rim, rel=1e-9)


def test_a_touch_that_barely_meets_the_rim_is_held_off_it():
    """Its nearest point lies between those that tell how far others are."""
    away, angle = 80.0 - 5.0 * (1.0 + 3e-4), np.pi / 128
    touch = Touch(away * np.cos(angle), away * np.sin(angle), 5.0)
    assert Forward(skin(), "diagnose").edge(touch).held_off


@pytest.mark.parametrize("accuracy", ["train", "diagnose"])
@pytest.mark.parametrize("touch", [Touch(200.0, 0.0, 130.0), Touch(300.0, 0.0, 240.0)])
def test_a_touch_far_off_a_shaped_skin_is_refused(accuracy, touch):
    forward = Forward(skin(shape_cos={1: 0.1}), accuracy)
    with pytest.raises(InputError, match="a place on the skin"):
        forward.transfer_impedance([replace(touch, contrast=1.0)])
