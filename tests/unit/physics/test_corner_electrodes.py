"""Electrodes round a corner: closed forms, mirror images, continuity, derivatives, touches."""

import numpy as np
import pytest

from eitskin.errors import InputError
from eitskin.physics.electrode_pieces import pieces
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.protocol import channel_table
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.solver import forward_model
from eitskin.physics.touch import Touch

L_SHAPE = RimCurve(((0, 0), (100, 0), (100, 50), (50, 50), (50, 100), (0, 100)))
RECTANGLE = RimCurve(((0, 0), (120, 0), (120, 80), (0, 80)))
SQUARE = RimCurve(((0, 0), (100, 0), (100, 100), (0, 100)))
ARC = 60.0 * np.exp(1j * np.linspace(0.0, np.pi, 201))
HALF_DISC = RimCurve(tuple(zip(ARC.real, ARC.imag, strict=True)), smooth=True)
CHANNELS = channel_table(8, "adjacent", "adjacent")


def skin(rim, at_mm, width_mm=6.0, **values):
    """Electrodes at lengths from the first corner."""
    return Geometry(
        rim.perimeter_mm / (2.0 * np.pi),
        3.0,
        0.5,
        360.0 * np.array(at_mm, float) / rim.perimeter_mm,
        width_mm,
        values.pop("contact_impedivity_ohm_m2", 1e-3),
        outline=rim,
        **values,
    )


def around(rim, corner, offset_mm=0.0, **values):
    """Eight even electrodes, the first centred so far from a corner."""
    start = rim.corner_phi[corner] / (2.0 * np.pi) * rim.perimeter_mm + offset_mm
    return skin(rim, start + rim.perimeter_mm * np.arange(8) / 8.0, **values)


@pytest.mark.parametrize("accuracy", ["train", "diagnose"])
def test_sides_that_are_electrodes_have_their_closed_form(accuracy):
    """An even current through a strip between two sides with contacts."""
    geometry = skin(RECTANGLE, [160.0, 360.0], 80.0, contact_impedivity_ohm_m2=2e-3)
    impedance = Forward(geometry, accuracy).transfer_impedance()
    resistance = impedance[0, 0] + impedance[1, 1] - impedance[0, 1] - impedance[1, 0]
    expected = geometry.sheet_resistance_ohm * 120.0 / 80.0 + 2.0 * 2e-3 / (3e-3 * 80e-3)
    assert resistance == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("touches", [0, 1])
def test_a_square_is_a_triangle_with_its_mirror_image(touches):
    """Round two of the square's corners one electrode is two halves; on the triangle, which the
    diagonal cuts off, it is one half that ends at the corner."""
    triangle = RimCurve(((0, 0), (100, 0), (100, 100)))
    at, width = [2.0, 30.0, 62.0, 101.0, 140.0, 198.0], [4.0, 5.0, 5.0, 6.0, 5.0, 4.0]
    mirrored_at = [400.0 - place for place in at[1:5]]
    whole_at = [0.0, *at[1:5], 200.0, *mirrored_at]
    whole_width = np.array([8.0, *width[1:5], 8.0, *width[1:5]])
    mirror = [0, 6, 7, 8, 9, 5]
    halved = Forward(skin(triangle, at, np.array(width)))
    whole = Forward(skin(SQUARE, whole_at, whole_width))
    assert len(halved.electrodes.phi) == 7 and len(whole.electrodes.phi) == 14
    places = [Touch(70.0, 20.0, 6.0, 1.5), Touch(20.0, 70.0, 6.0, 1.5)]
    impedance = whole.transfer_impedance(places[: 2 * touches])
    channels = channel_table(6, "adjacent", "adjacent")
    expected = channel_values(impedance[:6, :6] + impedance[:6, mirror], channels)
    read = halved.voltages(channels, places[:touches])
    np.testing.assert_allclose(read, expected, rtol=0, atol=2e-7 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("rim", "corner"), [(RECTANGLE, 1), (L_SHAPE, 3), (HALF_DISC, 1)], ids=["out", "in", "arc"]
)
def test_readings_are_continuous_where_a_corner_comes_under_an_electrode(rim, corner):
    """By the electrode's end and by its middle; its pieces may be as short as they come."""
    for end in (-3.0, 0.0, 3.0):
        centred = Forward(around(rim, corner, end)).voltages(CHANNELS)
        for step in (1e-12, 1e-8, 6e-6, 1e-4):
            for sign in (-1.0, 1.0):
                moved = Forward(around(rim, corner, end + sign * step)).voltages(CHANNELS)
                difference = np.abs(moved - centred).max() / np.abs(centred).max()
                assert difference < 3e-8 + step


def test_pieces_are_told_by_their_electrodes():
    split = pieces(around(RECTANGLE, 1, 1.0))
    assert split.electrode.tolist() == [0, 0, 1, 2, 3, 4, 4, 5, 6, 7]
    np.testing.assert_allclose(split.half[:2] * RECTANGLE.perimeter_mm / np.pi, [2.0, 4.0])
    assert split.corner[:2].tolist() == [[-1, 1], [1, -1]]
    narrow = RimCurve(((0, 0), (100, 0), (100, 4), (0, 4)))
    assert len(pieces(skin(narrow, [102.0, 206.0], 10.0)).electrode) == 6


@pytest.mark.parametrize(
    ("rim", "corner"), [(RECTANGLE, 1), (L_SHAPE, 3), (HALF_DISC, 1)], ids=["out", "in", "arc"]
)
@pytest.mark.parametrize(
    "name",
    [
        *("electrode_deg[0]", "electrode_width_mm[0]", "contact_impedivity_ohm_m2[0]"),
        *("conductivity_S_per_m", "shape_cos[2]", "stretch_x", "anisotropy_ratio", "x_mm[0]"),
    ],
)
def test_derivatives_are_those_of_differences(name, rim, corner):
    start = around(rim, corner, 1.1, shape_cos={2: 0.01}, anisotropy_ratio=1.1)
    place = rim.centre
    kind, _, index = name.rstrip("]").partition("[")

    def touched(step=0.0):
        return [Touch(place.real + step, place.imag, 5.0, 1.0)]

    exact = Forward(start).derivatives(touched(), [name])[name]
    value = None if kind == "x_mm" else getattr(start, kind)
    step = 1e-5 if kind == "contact_impedivity_ohm_m2" else 1e-4

    def impedance(step):
        if kind == "x_mm":
            return Forward(start).transfer_impedance(touched(step))
        if kind == "shape_cos":
            changed = {2: value[2] + step}
        else:
            changed = value + step * (np.arange(8) == int(index)) if index else value + step
        return Forward(start.with_values(**{kind: changed})).transfer_impedance(touched())

    difference = (impedance(step) - impedance(-step)) / (2.0 * step)
    exact, difference = (channel_values(slope, CHANNELS) for slope in (exact, difference))
    np.testing.assert_allclose(exact, difference, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_touches_contacts_and_patches_are_those_of_a_finer_expansion():
    """Modes of a place, a grounded probe and a patch, beside electrodes round corners."""
    geometry = around(L_SHAPE, 3, 1.1)
    forward = Forward(geometry)
    place = (25.0, 20.0, 5.0)
    change = forward.place(*place).impedance_change([1.0])[0]
    solved = forward.transfer_impedance([Touch(*place, 1.0)]) - forward.transfer_impedance()
    np.testing.assert_allclose(
        channel_values(change, CHANNELS), channel_values(solved, CHANNELS), rtol=1e-6, atol=1e-9
    )
    contact = forward.contact(*place).impedance_change([0.0])[0]
    electrodes = contact[-1, :8] - contact[-1, :8].mean()
    coarse = Forward(geometry, "train").contact(*place).impedance_change([0.0])[0][-1, :8]
    np.testing.assert_allclose(electrodes, coarse - coarse.mean(), atol=1e-3 * np.ptp(electrodes))
    patched = geometry.with_values(patches=(Patch(*place, 2.0),))
    by_patch = forward_model(patched).transfer_impedance() - forward.transfer_impedance()
    np.testing.assert_allclose(
        channel_values(by_patch, CHANNELS), channel_values(solved, CHANNELS), rtol=1e-5, atol=1e-8
    )


def test_points_at_a_corner_and_depths_are_refused():
    with pytest.raises(InputError, match="electrode 0, a point, at a corner"):
        around(SQUARE, 0, width_mm=0.0)
    with pytest.raises(InputError, match="bodies are discs"):
        around(SQUARE, 0, electrode_height_mm=3.0)
