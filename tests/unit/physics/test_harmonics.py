"""Harmonics of touches and what their polarisation makes on the rim, against closed forms."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from eitskin.physics import neumann
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.harmonics import Harmonics, RimField
from eitskin.physics.touch import Circle, even_nodes

RIM = np.exp(1j * np.linspace(0.1, 6.2, 50))
DEGREE = 5


@given(away=st.floats(0.0, 0.8), angle=st.floats(0.0, 6.3), radius=st.floats(0.01, 0.15))
def test_on_a_circle_each_multipole_makes_its_own_power(away, angle, radius):
    """Re and -Im of (radius / (x - centre))^k, as the real line integrals over a circle say."""
    centre = np.array(away * np.exp(1j * angle))
    t, weight = even_nodes(24)
    zeta = centre + radius * np.exp(1j * t)
    harmonics = Harmonics(DEGREE, centre, np.array(radius))
    dzeta = 1j * (zeta - centre) * weight
    found = RimField(harmonics, zeta, dzeta, harmonics.values(zeta)).potential(RIM)
    order = np.arange(1, DEGREE + 1)
    power = (radius / (RIM[:, None] - centre)) ** order / np.sqrt(np.pi * order)
    np.testing.assert_allclose(found, np.hstack([power.real, -power.imag]), atol=1e-13)


SKIN = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3)
SKINS = [
    Forward(SKIN.with_values(shape_cos={2: 0.03, 3: 0.01})),
    Forward(SKIN.with_values(anisotropy_ratio=3.0)),
]


@pytest.mark.parametrize("skin", SKINS, ids=["shaped", "anisotropic"])
@given(away=st.floats(0.0, 60.0), angle=st.floats(0.0, 6.3))
@example(away=60.0, angle=0.0)
@example(away=60.0, angle=0.5 * np.pi)
def test_the_field_is_the_double_layer(skin, away, angle):
    """As its integral over many more nodes, to the nodes' own error."""
    circle = Circle(away * np.exp(1j * angle), 6.0, skin.geometry, skin.disc)
    found = {}
    for count in (32, 512):
        t, weight = even_nodes(count)
        zeta, tangent = circle.mapped(t, 1)
        harmonics = Harmonics.around(circle.mapped(even_nodes(32)[0], 0)[0], DEGREE)
        values = harmonics.values(zeta)
        if count == 32:
            found[count] = RimField(harmonics, zeta, tangent * weight, values).potential(RIM)
        else:
            found[count] = neumann.rim_flux_kernel(RIM, zeta, tangent * weight) @ values
    size = np.abs(found[512]).max()
    np.testing.assert_allclose(found[32], found[512], rtol=0.0, atol=1e-6 * size)
