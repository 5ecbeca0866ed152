"""The touch as a terminal, and what a grounded probe takes, against quadrature, finite elements and
a network of resistors."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import dblquad
from skfem import Basis, LinearForm

import reference_patch as reference
from benchmark.finite_elements import FiniteElements
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.contact_current import EvenCurrent
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry, Patch
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.physics.solver import forward_model
from eitskin.physics.touch import Touch
from eitskin.simulate.leaks import leaking_potential
from eitskin.simulate.readings import simulate
from symmetric_mesh import symmetric_disc_mesh

CHANNELS = channel_table(16)
COUNTS = site_counts(CHANNELS)
ELECTRODES = np.arange(16) * 22.5
SKIN = Geometry(80.0, 3.0, 0.5, ELECTRODES, 5.0, 2e-3)
RESISTANCE = 1e3 / (0.5 * 3.0)


def terminals(forward, place, contrast):
    """(n + 1, n + 1) against the first electrode, whose row and column fall out."""
    full = np.pad(forward.transfer_impedance(), (0, 1))
    full += forward.contact(*place).impedance_change([contrast])[0]
    return full[1:, 1:] - full[1:, :1] - full[:1, 1:] + full[0, 0]


@pytest.mark.long
@pytest.mark.parametrize("layers", [(1.0, 5.0), (2.0, 1.0), (2.0, 5.0)])
def test_against_finite_elements(layers):
    """A concentric touch, in a patch or not; the current is put in evenly, node by node."""
    patch, touched = layers
    mesh, electrodes = symmetric_disc_mesh(16, 5.0 / 80.0, 2, 3, rings=(0.25, 0.5))
    mesh = mesh.scaled(0.08)
    elements = FiniteElements(mesh, electrodes, contact=2e-3 / 3e-3, order=2)
    r = np.hypot(*mesh.p[:, mesh.t[:3]].mean(axis=1))
    conductance = 1.5e-3 * np.where(r < 0.02, touched, 1.0) * np.where(r < 0.04, patch, 1.0)
    inside = Basis(
        mesh, elements.basis.elem, mapping=elements.basis.mapping, elements=np.flatnonzero(r < 0.02)
    )
    load = LinearForm(lambda v, w: 1.0 * v).assemble(inside)
    currents = np.zeros((elements._size, 17))
    currents[elements._terminals, range(16)] = 1.0
    currents[: len(load), 16] = load / load.sum()
    forward = forward_model(SKIN.with_values(patches=(Patch(0.0, 0.0, 40.0, patch),)))
    expected, even = (
        currents.T @ elements.factored(sheet).solve(currents)
        for sheet in (conductance, np.full(len(r), 1.5e-3))
    )
    expected, even = (
        full[1:, 1:] - full[1:, :1] - full[:1, 1:] + full[0, 0] for full in (expected, even)
    )
    found = terminals(forward, (0.0, 0.0, 20.0), touched - 1.0)
    assert np.abs(found - expected).max() < 5e-4 * np.abs(expected).max()
    # the elements' error at the electrodes' edges is that of the even skin
    change, other = found - terminals(Forward(SKIN), (0.0, 0.0, 20.0), 0.0), expected - even
    assert np.abs(change - other).max() < 2e-4 * np.abs(other).max()
    assert change[-1, -1] == pytest.approx(other[-1, -1], rel=2e-5)


@pytest.mark.parametrize("ratio", [1.0, 1.6])
def test_the_mean_over_the_touch_by_quadrature(ratio):
    """Coupling to a rim point, and to the touch itself, of a touch without contrast."""
    geometry = Geometry(
        80.0, 3.0, 0.5, ELECTRODES, 0.0, 0.0, anisotropy_ratio=ratio, anisotropy_deg=30.0
    )
    forward = Forward(geometry)
    x, y, radius = 40.0, 25.0, 9.0
    own = forward.contact(x, y, radius).contact_impedance / RESISTANCE
    rho, weight = np.polynomial.legendre.leggauss(24)
    rho, weight = 0.5 * (1 + rho), 0.5 * weight * 0.5 * (1 + rho) * 2
    phi = 2 * np.pi * np.arange(64) / 64
    disc = (x + 1j * y + radius * rho[:, None] * np.exp(1j * phi)).ravel()
    share = np.repeat(weight, 64) / 64
    zeta = forward.disc(geometry.unfold(disc))
    rim = forward.electrodes.rim
    assert own[-1, :-1] == pytest.approx(share @ reference.potential(zeta, rim), abs=1e-10)

    def mean_of_log(sx, sy):
        """-ln|x - y| / 2 pi over a unit disc stretched: radial parts by hand, angles summed."""
        angle = 2 * np.pi * (np.arange(256) + 0.5) / 256
        stretch = np.log(np.hypot(sx * np.cos(angle), sy * np.sin(angle))).mean()
        return -(stretch - 0.25) / (2 * np.pi)

    unfolded = geometry.unfold(disc)
    apart = np.abs(unfolded[:, None] - unfolded) + np.eye(len(disc))
    near = np.abs(zeta[:, None] - zeta) + np.eye(len(disc))
    image = -np.log(near / apart * np.abs(1 - zeta[:, None] * np.conj(zeta))) / (2 * np.pi)
    slope = np.abs(forward.disc.derivatives(unfolded, 1)[1])
    np.fill_diagonal(image, -np.log(slope * (1 - np.abs(zeta) ** 2)) / (2 * np.pi))
    squeeze = ratio**-0.25
    direct = mean_of_log(radius * squeeze, radius / squeeze)
    assert own[-1, -1] == pytest.approx(direct + share @ image @ share, abs=1e-9)


def test_the_mean_of_a_logarithm_over_a_disc():
    """-(ln a - 1 / 4), by brute force."""
    inner = dblquad(
        lambda s, r: 4 * r * s * -np.log(max(r, s)), 0.0, 1.0, 0.0, lambda _: 1.0, epsabs=1e-10
    )
    assert inner[0] == pytest.approx(0.25, abs=1e-8)


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_the_power_within_the_touch(ratio):
    """psi = 0 on the ellipse's edge, -div grad psi = 1 / area, and its mean."""
    geometry = SKIN.with_values(anisotropy_ratio=ratio)
    forward = Forward(geometry)
    found = EvenCurrent(forward.edge(Touch(10.0, 20.0, 8.0))).inner_power
    a, b = 8.0 * ratio**-0.25, 8.0 * ratio**0.25

    def psi(x, y):
        return (1 - (x / a) ** 2 - (y / b) ** 2) / (2 * np.pi * a * b * (a**-2 + b**-2))

    across = psi(1.5, 2.0) + psi(0.5, 2.0) + psi(1.0, 2.5) + psi(1.0, 1.5) - 4 * psi(1.0, 2.0)
    assert -across / 0.25 == pytest.approx(1 / (np.pi * a * b))
    rho = np.sqrt((np.arange(2000) + 0.5) / 2000)[:, None]
    phi = 2 * np.pi * np.arange(32) / 32
    mean = psi(a * rho * np.cos(phi), b * rho * np.sin(phi)).mean()
    assert found == pytest.approx(mean, rel=1e-6)


def test_an_eccentric_touch_against_its_surface_charges():
    """By reciprocity: the mean potential of a touch is the one at its centre."""
    points = Geometry(80.0, 3.0, 0.5, ELECTRODES, 0.0, 0.0)
    for factor, circles in (
        (2.5, [(-0.25 + 0j, 0.2), (0.4 + 0.3j, 0.1)]),
        (0.4, [(0.4 + 0.2j, 0.3), (0.4 + 0.3j, 0.1)]),
    ):
        centre, radius = (80.0 * np.array(part) for part in circles[0])
        skin = points.with_values(patches=(Patch(centre.real, centre.imag, radius, factor),))
        expected = reference.mean_inside(np.radians(ELECTRODES), circles, [factor, 4.0])
        found = forward_model(skin).contact(32.0, 24.0, 8.0).impedance_change([3.0])[0, -1, :-1]
        expected = RESISTANCE * (expected - expected[0])
        assert found - found[0] == pytest.approx(expected, rel=1e-6, abs=1e-6 * expected.max())


def test_more_conductivity_takes_less_power():
    forward = forward_model(SKIN.with_values(patches=(Patch(30.0, 20.0, 15.0, 2.0),)))
    less, more = (terminals(forward, (30.0, 22.0, 6.0), c) for c in (0.5, 3.0))
    assert np.linalg.eigvalsh(less - more).min() > -1e-9 * np.abs(less).max()
    assert np.linalg.eigvalsh(more).min() > 0


def test_refusals():
    with pytest.raises(InputError, match="clipped by the rim"):
        Forward(SKIN).contact(78.0, 0.0, 8.0)
    with pytest.raises(InputError, match="across a patch's edge"):
        forward_model(SKIN.with_values(patches=(Patch(30.0, 0.0, 9.0, 2.0),))).contact(
            39.0, 0.0, 5.0
        )
    with pytest.raises(InputError, match="gradient of the conductivity"):
        Forward(SKIN.with_values(gradient_across=0.1)).contact(30.0, 0.0, 5.0)


STATES = pd.DataFrame(
    {
        "time_s": np.arange(5.0),
        "touch": [False, True, True, True, True],
        "x_mm": [np.nan, 30.0, 30.0, -20.0, 120.0],
        "y_mm": [np.nan, 10.0, 10.0, 40.0, 0.0],
        "force_N": [0.0, 1.0, 4.0, 2.0, 3.0],
        "probe_mm": [np.nan, 10.0, 10.0, 16.0, 10.0],
    }
)
PRESS = np.array([-1, 0, 0, 1, 2])
BELIEVED = Skin(80.0, 3.0, 0.5, tuple(ELECTRODES), 5.0, 2e-3, 1e-3, 0.9)


def readings(*items, sink_grounded=False):
    chosen = settings(list(items), COUNTS, (0, 0))
    return simulate(STATES, PRESS, BELIEVED, CHANNELS, chosen, "train", sink_grounded=sink_grounded)


PROBE = {"name": "indenter-grounding", "parameters": {"siemens_per_N": 2e-4}}
LEAK = {"name": "ground-leak", "electrodes": [5], "parameters": {"siemens": 1e-3}}


def test_one_grounded_probe_under_a_floating_source_carries_nothing():
    clean = readings()
    assert np.allclose(readings(PROBE), clean, rtol=0, atol=1e-10 * np.abs(clean).max())


def test_with_a_leak_it_does_and_only_where_it_touches():
    clean, found = readings(), readings(PROBE, LEAK)
    change = np.abs(found - clean).max(axis=1) / np.abs(clean).max()
    assert (change[[0, 4]] < 1e-12).all()
    assert (change[1:4] > 1e-3).all()
    assert np.array_equal(found, readings(LEAK, PROBE))


@pytest.mark.parametrize("sink_grounded", [False, True])
def test_readings_against_a_network_with_its_ground(sink_grounded):
    """The skin and the touch as a network of conductances, the leaks among them."""
    forward = Forward(SKIN, "train")
    found = readings(PROBE, LEAK, sink_grounded=sink_grounded)
    for row in (1, 2, 3):
        state = STATES.iloc[row]
        place = (state["x_mm"], state["y_mm"], 0.5 * state["probe_mm"])
        against = terminals(forward, place, 0.9 * state["force_N"])
        inverse = np.linalg.inv(against)
        network = np.zeros((17, 17))
        network[1:, 1:] = inverse
        network[0, 1:] = network[1:, 0] = -inverse.sum(axis=0)
        network[0, 0] = inverse.sum()
        network[5, 5] += 1e-3
        network[16, 16] += 2e-4 * state["force_N"]
        expected = []
        for source, sink, plus, minus in CHANNELS:
            current = np.zeros(17)
            current[source], current[sink] = 1e-3, -1e-3
            free = np.delete(np.arange(17), sink) if sink_grounded else np.arange(17)
            potential = np.zeros(17)
            potential[free] = np.linalg.solve(network[np.ix_(free, free)], current[free])
            expected.append(potential[plus] - potential[minus])
        assert found[row] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_point_electrodes_cannot_leak():
    with pytest.raises(InputError, match="a width above 0"):
        leaking_potential(
            np.zeros((1, 1, 2)), np.ones((1, 2)), np.full((1, 2, 2), np.nan), None, False
        )
