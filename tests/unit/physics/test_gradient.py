"""A conductivity that rises across the skin, against finite elements with it element by element."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.finite_elements import FiniteElements
from eitskin.errors import InputError
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.physics.touch import Touch
from symmetric_mesh import symmetric_disc_mesh
from witness import laws
from witness.boundary import Body, Disc

CHANNELS = channel_table(16)
SKIN = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 2e-3)


def change_of(impedance, touched):
    return channel_values(touched, CHANNELS) - channel_values(impedance, CHANNELS)


def off(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.fixture(scope="module")
def mesh():
    return symmetric_disc_mesh(16, 5.0 / 80.0, 2, 3, rings=(0.25,))


def conductance(mesh, across, direction):
    x, y = 1e3 * mesh.p[:, mesh.t[:3]].mean(axis=1)
    phi = np.radians(direction)
    return 1.5e-3 * (1 + across * (np.cos(phi) * x + np.sin(phi) * y) / 160.0)


@pytest.mark.parametrize(("across", "direction"), [(0.1, 0.0), (0.3, 40.0)])
def test_untouched_against_finite_elements(mesh, across, direction):
    disc = mesh[0].scaled(0.08)
    elements = FiniteElements(disc, mesh[1], contact=2e-3 / 3e-3, order=2)
    expected = channel_values(
        elements.transfer_impedance(conductance(disc, across, direction)), CHANNELS
    )
    found = Forward(SKIN.with_values(gradient_across=across, gradient_deg=direction))
    assert off(found.voltages(CHANNELS), expected) < 2e-5
    assert off(Forward(SKIN).voltages(CHANNELS), expected) > 0.03


@pytest.mark.parametrize("shift", [0.0, 0.3 + 0.2j])
def test_touch_against_finite_elements(mesh, shift):
    """A map of the disc onto itself takes the mesh's ring to a touch off its centre."""

    def moved(z):
        return (z + shift) / (1.0 + np.conj(shift) * z)

    place = moved(mesh[0].doflocs[0] + 1j * mesh[0].doflocs[1])
    disc = replace(mesh[0], doflocs=np.array([place.real, place.imag])).scaled(0.08)
    ahead = np.exp(1j * np.angle(shift))
    ends = 80.0 * moved(0.25 * ahead * np.array([1.0, -1.0]))
    centre, radius = ends.mean(), 0.5 * abs(ends[0] - ends[1])
    phi = np.radians(SKIN.electrode_deg)[:, None] + np.array([-1.0, 1.0]) * 2.5 / 80.0
    angle = np.unwrap(np.angle(moved(np.exp(1j * phi))), axis=1)
    skin = SKIN.with_values(
        electrode_deg=np.degrees(angle.mean(axis=1)),
        electrode_width_mm=80.0 * np.diff(angle, axis=1)[:, 0],
        gradient_across=0.5,
        gradient_deg=40.0,
    )
    elements = FiniteElements(disc, mesh[1], contact=2e-3 / 3e-3, order=2)
    x, y = 1e3 * disc.p[:, disc.t[:3]].mean(axis=1)
    inside = np.where(np.abs(x + 1j * y - centre) < radius, 5.0, 1.0)
    sheet = conductance(disc, 0.5, 40.0)
    expected = change_of(
        elements.transfer_impedance(sheet), elements.transfer_impedance(sheet * inside)
    )
    forward = Forward(skin)
    touch = Touch(centre.real, centre.imag, radius, 4.0)
    found = change_of(forward.transfer_impedance(), forward.transfer_impedance([touch]))
    assert off(found, expected) < 1e-3


@pytest.mark.long
@pytest.mark.parametrize(
    ("across", "discs", "most"),
    [
        (0.05, [(30.0, 20.0, 10.0, 4.0)], 5e-6),
        (0.3, [(0.0, 0.0, 10.0, 4.0)], 5e-5),
        (0.3, [(-45.0, -20.0, 5.0, -0.8)], 5e-5),
        (0.3, [(60.0, 0.0, 19.0, 2.0)], 2e-4),
        (0.3, [(30.0, 20.0, 10.0, 4.0), (30.0, -5.0, 8.0, 2.0)], 5e-5),
        (0.9, [(30.0, 20.0, 10.0, 4.0)], 3e-4),
        (0.9, [(20.0, -40.0, 20.0, 1.0)], 2e-3),
    ],
)
def test_touches_against_boundary_integrals(across, discs, most):
    law = {"relative_across": across, "angle_deg": 40.0}
    shape = laws.outline([{"name": "conductivity-gradient", "parameters": law}], 80.0)
    body = Body(shape, SKIN.electrode_deg, SKIN.electrode_width_mm, 0.7)
    contact = body.contact(np.full(16, 1e3 * 2e-3 * 0.5 / 80.0))
    places = body.place([Disc(*disc[:3]) for disc in discs])
    contrasts = [disc[3] for disc in discs]
    untouched, touched = (
        np.linalg.pinv(1.5e-3 * places.admittance(contact, c)) for c in (0 * contrasts, contrasts)
    )
    forward = Forward(SKIN.with_values(gradient_across=across, gradient_deg=40.0))
    found = forward.transfer_impedance([Touch(*disc) for disc in discs])
    plain = channel_values(untouched, CHANNELS)
    assert off(forward.voltages(CHANNELS), plain) < 1e-5 * max(across, across**2 / 0.3)
    assert off(change_of(forward.transfer_impedance(), found), change_of(untouched, touched)) < most


@pytest.mark.long
@pytest.mark.parametrize("touch", [Touch(75.0, 0.0, 10.0, 2.0), Touch(-40.0, -65.0, 12.0, -0.7)])
def test_clipped_touch_against_finite_elements(mesh, touch):
    """What the gradient changes of a touch's signal; the elements' jagged edge drops out of it."""
    disc = mesh[0].scaled(0.08)
    elements = FiniteElements(disc, mesh[1], contact=2e-3 / 3e-3, order=2)
    x, y = 1e3 * disc.p[:, disc.t[:3]].mean(axis=1)
    near = np.hypot(x - touch.x_mm, y - touch.y_mm) < touch.radius_mm
    inside = np.where(near, 1.0 + touch.contrast, 1.0)
    expected, found = [], []
    for across in (0.0, 0.3):
        sheet = conductance(disc, across, 40.0)
        expected.append(
            change_of(
                elements.transfer_impedance(sheet), elements.transfer_impedance(sheet * inside)
            )
        )
        forward = Forward(SKIN.with_values(gradient_across=across, gradient_deg=40.0))
        found.append(change_of(forward.transfer_impedance(), forward.transfer_impedance([touch])))
    assert off(found[1] - found[0], expected[1] - expected[0]) < 0.03


def test_symmetries():
    forward = Forward(SKIN.with_values(gradient_across=0.2, gradient_deg=90.0))
    touch = Touch(20.0, 30.0, 7.0, 3.0)
    found = forward.voltages(CHANNELS, [touch])
    pairs, sign = reciprocal_channels(CHANNELS)
    odd = found[pairs[:, 0]] - sign * found[pairs[:, 1]]
    assert np.abs(odd).max() < 1e-12 * np.abs(found).max()
    turned = Forward(SKIN.with_values(gradient_across=0.2, gradient_deg=0.0))
    quarter = turned.transfer_impedance([Touch(30.0, -20.0, 7.0, 3.0)])
    assert np.allclose(
        np.roll(quarter, (4, 4), (0, 1)), forward.transfer_impedance([touch]), atol=1e-9
    )


def test_all_forces_at_a_place_and_single_solves_agree():
    forward = Forward(SKIN.with_values(gradient_across=0.2))
    single = forward.voltages(CHANNELS, [Touch(20.0, 30.0, 7.0, 3.0)])
    modes = forward.place(20.0, 30.0, 7.0).channel_change(CHANNELS, [3.0])[0]
    assert np.allclose(forward.voltages(CHANNELS) + modes, single, rtol=1e-11)


def test_refusals():
    with pytest.raises(InputError, match="above 0 everywhere"):
        Forward(SKIN.with_values(gradient_across=2.5))
    with pytest.raises(InputError, match="to differentiate"):
        Forward(SKIN.with_values(gradient_across=0.1)).derivatives()
