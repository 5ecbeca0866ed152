"""A conductivity that rises across the skin, against finite elements with it element by element."""

import numpy as np
import pytest

from eitskin.errors import InputError
from eitskin.fem import FiniteElements, symmetric_disc_mesh
from eitskin.forward import Forward, channel_values
from eitskin.geometry import Geometry
from eitskin.protocol import channel_table, reciprocal_channels
from eitskin.touch import Touch

CHANNELS = channel_table(16)
SKIN = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 2e-3)


@pytest.fixture(scope="module")
def mesh():
    unit, electrodes = symmetric_disc_mesh(16, 5.0 / 80.0, 2, 3, rings=(0.25,))
    return unit.scaled(0.08), electrodes


@pytest.mark.parametrize(("across", "direction"), [(0.1, 0.0), (0.3, 40.0)])
def test_against_finite_elements(mesh, across, direction):
    elements = FiniteElements(mesh[0], mesh[1], contact=2e-3 / 3e-3, order=2)
    x, y = 1e3 * mesh[0].p[:, mesh[0].t[:3]].mean(axis=1)
    phi = np.radians(direction)
    conductance = 1.5e-3 * (1 + across * (np.cos(phi) * x + np.sin(phi) * y) / 160.0)
    inside = np.where(np.hypot(x, y) < 20.0, 5.0, 1.0)
    expected = channel_values(elements.transfer(conductance), CHANNELS)
    touched = channel_values(elements.transfer(conductance * inside), CHANNELS) - expected
    forward = Forward(SKIN.with_values(gradient_across=across, gradient_deg=direction))
    found = forward.voltages(CHANNELS)
    change = forward.voltages(CHANNELS, [Touch(0.0, 0.0, 20.0, 4.0)]) - found
    median = np.median(np.abs(expected))
    plain = Forward(SKIN).voltages(CHANNELS)
    assert np.sqrt(((found - expected) ** 2).mean()) < 5e-5 * median
    assert np.sqrt(((plain - expected) ** 2).mean()) > 0.05 * median
    assert np.linalg.norm(change - touched) < 1e-2 * across * np.linalg.norm(touched)


def test_symmetries():
    forward = Forward(SKIN.with_values(gradient_across=0.2, gradient_deg=90.0))
    touch = Touch(20.0, 30.0, 7.0, 3.0)
    found = forward.voltages(CHANNELS, [touch])
    pairs, sign = reciprocal_channels(CHANNELS)
    odd = found[pairs[:, 0]] - sign * found[pairs[:, 1]]
    assert np.abs(odd).max() < 1e-12 * np.abs(found).max()
    turned = Forward(SKIN.with_values(gradient_across=0.2, gradient_deg=0.0))
    quarter = turned.transfer([Touch(30.0, -20.0, 7.0, 3.0)])
    assert np.allclose(np.roll(quarter, (4, 4), (0, 1)), forward.transfer([touch]), atol=1e-9)


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
