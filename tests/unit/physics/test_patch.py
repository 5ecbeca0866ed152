"""Touches on a patched skin: layers in closed form, a boundary integral of its own, two touches."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import reference_patch as reference
from eitskin.errors import InputError
from eitskin.physics.forward import Accuracy, Forward, channel_values
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.patch import PatchForward
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.physics.solver import forward_model
from eitskin.physics.touch import Touch, TouchAccuracy

CHANNELS = channel_table(16)
ELECTRODES = np.arange(16) * 22.5
POINTS = Geometry(80.0, 3.0, 0.5, ELECTRODES, 0.0, 0.0)
SKIN = Geometry(80.0, 3.0, 0.5, ELECTRODES, 5.0, 1e-3)
RESISTANCE = 1e3 / (0.5 * 3.0)
FINER = Accuracy(24, TouchAccuracy(48, 1e-10, 16, 2e-4), 64)
APART = {
    "disjoint": (30 + 10j, 8.0, -20.0, 16.0),
    "touch in patch": (-16 + 2j, 5.0, -20.0, 16.0),
    "patch in touch": (-20 + 2j, 8.0, -21.0, 5.0),
    "near, disjoint": (30.0, 8.0, 0.0, 21.5),
    "near, in patch": (8.0, 5.0, -4.0, 17.5),
}
CROSSING = {
    "at right angles": (20 + 10j, 8.0, 5 + 5j, 16.0),
    "grazing from outside": (23.8, 8.0, 0.0, 16.0),
    "grazing from inside": (8.2, 8.0, 0.0, 16.0),
    "small touch": (16.0, 2.5, 0.0, 16.0),
    "small patch": (20 + 10j, 8.0, 10 + 5j, 6.0),
    "of one size": (12.0, 8.0, 0.0, 8.0),
}


def patched(centre, radius, contrast, skin=POINTS):
    centre = complex(centre)
    return skin.with_values(patches=(Patch(centre.real, centre.imag, radius, contrast),))


def error(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


def touch_change(forward, place, contrast):
    centre, radius = complex(place[0]), place[1]
    modes = forward.place(centre.real, centre.imag, radius)
    return modes.channel_change(CHANNELS, [contrast])[0]


def reference_change(place, factor, contrast):
    """(M,): what the touch changes of the patched skin."""
    circles = [(place[2] / 80, place[3] / 80), (place[0] / 80, place[1] / 80)]
    both, patch = (
        reference.change(np.radians(ELECTRODES), circles, [factor, inner])
        for inner in (1.0 + contrast, 1.0)
    )
    return channel_values(both - patch, CHANNELS) * RESISTANCE


def layered(inner, inner_factor, outer, outer_factor):
    """(16, 16): change at rim points by two concentric layers, a Fourier series."""
    m = np.arange(1, 400)
    q = (inner_factor - outer_factor) / (inner_factor + outer_factor) * (inner / outer) ** (2 * m)
    factor = outer_factor * (1 + q) / (1 - q)
    q = (factor - 1) / (factor + 1) * outer ** (2.0 * m)
    angle = np.radians(ELECTRODES)[:, None] * m
    wave = -2 * q / (1 + q) / m / np.pi
    return (np.cos(angle) * wave) @ np.cos(angle).T + (np.sin(angle) * wave) @ np.sin(angle).T


def test_the_reference_against_layers_and_its_own_refinement():
    circles = [(0.0, 0.4), (0.0, 0.25)]
    found = reference.change(np.radians(ELECTRODES), circles, [2.5, 5.0])
    assert np.allclose(found, layered(0.25, 12.5, 0.4, 2.5), atol=1e-12)
    centre, radius, other, size = CROSSING["at right angles"]
    circles = [(other / 80, size / 80), (centre / 80, radius / 80)]
    coarse, fine = (
        channel_values(
            reference.change(np.radians(ELECTRODES), circles, [2.5, 10.0], levels), CHANNELS
        )
        for levels in (9, 14)
    )
    assert error(coarse, fine) < 1e-5


@pytest.mark.parametrize(("touch", "patch"), [(30.0, 20.0), (20.0, 30.0), (20.0, 20.8)])
def test_concentric_layers(touch, patch):
    factor, contrast = 2.5, 3.0
    inner, outer = sorted([touch, patch])
    between = factor if touch < patch else 1 + contrast
    both = layered(inner / 80, factor * (1 + contrast), outer / 80, between)
    alone = layered(patch / 160, factor, patch / 80, factor)
    forward = forward_model(patched(0.0, patch, factor))
    expected = channel_values(alone, CHANNELS) * RESISTANCE
    assert error(forward.voltages(CHANNELS) - Forward(POINTS).voltages(CHANNELS), expected) < 1e-10
    expected = channel_values(both - alone, CHANNELS) * RESISTANCE
    assert error(touch_change(forward, (0.0, touch), contrast), expected) < 1e-10


@pytest.mark.parametrize("factor", [0.4, 2.5])
@pytest.mark.parametrize("place", APART.values(), ids=APART)
def test_circles_that_do_not_cross(place, factor):
    for contrast in (-0.9, 9.0):
        expected = reference_change(place, factor, contrast)
        for accuracy, bound in (("train", 1e-5), ("diagnose", 1e-7)):
            forward = forward_model(patched(place[2], place[3], factor), accuracy)
            assert error(touch_change(forward, place, contrast), expected) < bound


@pytest.mark.parametrize("gap_mm", [20.0, 2.0, 0.5])
def test_several_patches(gap_mm):
    circles = [(-20.0, 16.0), (6.0 + gap_mm, 10.0), (-50j, 6.0)]
    factors = [0.1, 20.0, 2.5]
    places = [(complex(z).real, complex(z).imag, radius) for z, radius in circles]
    pairs = list(zip(places, factors, strict=True))
    bare, patches = Forward(POINTS), tuple(Patch(*place, factor) for place, factor in pairs)
    expected = reference.change(
        np.radians(ELECTRODES), [(z / 80, radius / 80) for z, radius in circles[:2]], factors[:2]
    )
    both = forward_model(POINTS.with_values(patches=patches[:2])).voltages(CHANNELS)
    changed = both - bare.voltages(CHANNELS)
    assert error(changed, channel_values(expected, CHANNELS) * RESISTANCE) < 1e-7
    three = forward_model(POINTS.with_values(patches=patches))
    touches = [Touch(*place, factor - 1.0) for place, factor in pairs]
    assert error(three.voltages(CHANNELS), bare.voltages(CHANNELS, touches)) < 1e-7
    with pytest.raises(InputError, match="one on a skin with several patches, expected none"):
        three.place(50.0, 40.0, 5.0)


def test_patches_that_overlap_are_refused():
    patches = Patch(0.0, 0.0, 10.0, 2.0), Patch(15.0, 0.0, 10.0, 3.0)
    with pytest.raises(InputError, match="two that overlap"):
        forward_model(SKIN.with_values(patches=patches))


@pytest.mark.parametrize("factor", [0.4, 2.5])
@pytest.mark.parametrize("place", CROSSING.values(), ids=CROSSING)
def test_circles_that_cross(place, factor):
    expected = reference_change(place, factor, 9.0)
    for accuracy, bound in (("train", 3e-3), ("diagnose", 5e-4)):
        forward = forward_model(patched(place[2], place[3], factor), accuracy)
        assert error(touch_change(forward, place, 9.0), expected) < bound


def test_a_touch_that_covers_the_patch():
    forward = forward_model(patched(20 + 10j, 8.0, 2.5))
    even = Forward(POINTS).place(20.0, 10.0, 8.0).channel_change(CHANNELS, [2.5 * 4.0 - 1.0, 1.5])
    assert error(touch_change(forward, (20 + 10j, 8.0), 3.0), even[0] - even[1]) < 1e-10
    near = touch_change(forward, (20 + 10j, 8.0 * 1.009), 3.0)
    exact = touch_change(forward, (20 + 10j, 8.0 * 1.011), 3.0)
    assert error(near, exact) < 2e-2


@pytest.mark.parametrize(
    "skin",
    [
        SKIN,
        SKIN.with_values(shape_cos={2: 0.04}, shape_sin={3: 0.03}),
        SKIN.with_values(anisotropy_ratio=1.4, anisotropy_deg=20.0, stretch_x=1.05),
    ],
)
@pytest.mark.parametrize("place", [(30.0, 20.0, 7.0), (74.0, 20.0, 8.0)])
def test_a_patch_off_the_touch_is_another_touch(skin, place):
    """On complete electrodes, other rims, and where the rim clips the touch."""
    factor, contrast = 2.2, 3.0
    forward = forward_model(patched(-10 - 20j, 14.0, factor, skin))
    as_touch = Touch(-10.0, -20.0, 14.0, factor - 1.0)
    even = Forward(skin)
    alone = even.voltages(CHANNELS, [as_touch])
    both = even.voltages(CHANNELS, [as_touch, Touch(*place, contrast)])
    assert error(forward.voltages(CHANNELS), alone) < 1e-9
    single = forward.voltages(CHANNELS, [Touch(*place, contrast)])
    assert error(single - forward.voltages(CHANNELS), both - alone) < 1e-6


@pytest.mark.parametrize(
    "place",
    [(20.0, 4.0, 7.0), (70.0, 10.0, 12.0), (55.0, 0.0, 3.0), (50.0, 5.0, 16.0)],
    ids=["crossing", "crossing and clipped", "in it", "round it"],
)
def test_other_skins_against_a_finer_expansion(place):
    skin = SKIN.with_values(shape_cos={2: 0.03}, anisotropy_ratio=1.3, anisotropy_deg=30.0)
    geometry = patched(20.0 if place[0] == 20.0 else 53.0, 9.0, 0.5, skin)
    found, finer = (
        touch_change(forward_model(geometry, a), (complex(*place[:2]), place[2]), 4.0)
        for a in ("diagnose", FINER)
    )
    assert error(found, finer) < 1e-3


def test_without_contrast_a_patch_is_none():
    """In the limit and at 1, also for touches that cross it."""
    even = Forward(SKIN).place(20.0, 4.0, 7.0).channel_change(CHANNELS, [2.0])[0]
    forward = forward_model(patched(20.0, 9.0, 1.0 + 1e-9, SKIN))
    assert error(touch_change(forward, (20 + 4j, 7.0), 2.0), even) < 1e-7
    assert type(forward_model(patched(20.0, 9.0, 1.0, SKIN))) is Forward


@settings(max_examples=15)
@given(
    apart=st.floats(0.0, 30.0),
    phi=st.floats(0.0, 360.0),
    radius=st.floats(2.0, 12.0),
    contrast=st.floats(-0.95, 20.0),
    factor=st.floats(0.1, 10.0),
)
def test_reciprocity_and_power_wherever_and_whatever(apart, phi, radius, contrast, factor):
    """More conductivity takes less power, by any current."""
    assume(abs(contrast) > 1e-3)
    forward = forward_model(patched(15 + 10j, 9.0, factor, SKIN), "train")
    place = 15 + 10j + apart * np.exp(1j * np.radians(phi))
    change = forward.place(place.real, place.imag, radius).impedance_change([contrast])[0]
    assert np.abs(change - change.T).max() <= 1e-12 * np.abs(change).max()
    power = np.linalg.eigvalsh(change - change.mean(0) - change.mean(1)[:, None] + change.mean())
    assert (-np.sign(contrast) * power > -1e-6 * np.abs(power).max()).all()
    pairs, sign = reciprocal_channels(CHANNELS)
    voltage = forward.voltages(CHANNELS)
    odd = voltage[pairs[:, 0]] - sign * voltage[pairs[:, 1]]
    assert np.abs(odd).max() < 1e-12 * np.abs(voltage).max()


def test_sharing_changes_nothing():
    first = forward_model(patched(20.0, 9.0, 2.0, SKIN))
    first.place(25.0, 4.0, 7.0)
    for skin in (
        patched(20.0, 9.0, 2.0, SKIN.with_values(contact_impedivity_ohm_m2=np.full(16, 2e-3))),
        patched(22.0, 9.0, 2.0, SKIN),
        SKIN.with_values(conductivity_S_per_m=0.6),
    ):
        shared, own = forward_model(skin, donor=first), forward_model(skin)
        assert type(shared) is type(own)
        assert np.array_equal(shared.transfer_impedance(), own.transfer_impedance())
        assert np.array_equal(shared.place(25.0, 4.0, 7.0).gains, own.place(25.0, 4.0, 7.0).gains)
    assert isinstance(forward_model(skin, donor=Forward(SKIN)), Forward)
    assert isinstance(first, PatchForward)


def test_a_body_with_electrodes_of_full_height_is_a_sheet():
    sheet = patched(20.0, 9.0, 2.0, SKIN)
    body = sheet.with_values(deep=True, electrode_height_mm=3.0)
    found, expected = (
        touch_change(forward_model(skin, "train"), (25 + 4j, 7.0), 3.0) for skin in (body, sheet)
    )
    assert error(found, expected) < 1e-3


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        (patched(75.0, 9.0, 2.0), "patch: found .* expected a disc within the skin"),
        (patched(200.0, 9.0, 2.0), "a disc within the skin"),
        (
            patched(20.0, 9.0, 2.0, SKIN.with_values(gradient_across=0.1)),
            "gradient of the conductivity",
        ),
    ],
)
def test_refuses_skins(geometry, message):
    with pytest.raises(InputError, match=message):
        forward_model(geometry)


def test_refuses_what_it_does_not_know():
    forward = forward_model(patched(20.0, 9.0, 2.0, SKIN))
    with pytest.raises(InputError, match="several"):
        forward.transfer_impedance([Touch(0.0, 0.0, 5.0, 1.0), Touch(30.0, 0.0, 5.0, 1.0)])
    with pytest.raises(InputError, match="to differentiate"):
        forward.derivatives()
    with pytest.raises(InputError, match="contrast: found 0"):
        Patch(0.0, 0.0, 5.0, 0.0)
