"""A touch's multipoles in depth against quadrature of the body's Neumann function."""

import numpy as np
import pytest
from scipy.special import iv, ivp, kv, kvp

from eitskin.physics.depth import DepthForward, Span
from eitskin.physics.geometry import Geometry
from eitskin.physics.touch import Touch

RADIUS_MM, DEPTH_MM = 100.0, 40.0
NEAR, BESIDE = Touch(70.0, 25.0, 15.0), Touch(30.0, 60.0, 20.0)


@pytest.fixture(scope="module")
def forward():
    geometry = Geometry(RADIUS_MM, DEPTH_MM, 0.5, 45.0 * np.arange(8), 10.0, 1e-2)
    return DepthForward(geometry, Span(12.0, 15.0))


def nodes(touch, count=96):
    angle = 2.0 * np.pi * np.arange(count) / count
    return (touch.x_mm + 1j * touch.y_mm + touch.radius_mm * np.exp(1j * angle)) / RADIUS_MM, angle


def fluxes(touch, column, sheet):
    """(count, kept): the kept multipoles' flux on the nodes, of unit energy."""
    k, angle = column.k[sheet], nodes(touch)[1]
    a = touch.radius_mm / RADIUS_MM
    found = []
    for index in column.kept_indices[sheet]:
        sine, order = divmod(int(index), column.degree + 1)
        wave = np.sin(order * angle) if sine else np.cos(order * angle)
        slope = k * ivp(order, k * a) / iv(order, k * a)
        found.append(wave * slope / np.sqrt(slope * a * (wave**2).sum() * angle[1]))
    return np.array(found).reshape(-1, len(angle)).T * a * angle[1]


def image(k, x, y):
    n = np.arange(-70, 71)[:, None]
    own = -kvp(n, k) / ivp(n, k) / (2.0 * np.pi)
    here, there = (
        iv(n, k * np.abs(z)) * np.exp(sign * 1j * n * np.angle(z)) for z, sign in ((x, 1), (y, -1))
    )
    return ((own * here).T @ there).real


def test_two_touches_respond_to_each_other(forward):
    a, b = forward.edge(NEAR), forward.edge(BESIDE)
    expected = np.zeros((len(a.self_response), len(b.self_response)))
    row = column = 0
    for sheet in range(min(len(a.k), len(b.k))):
        k, x, y = a.k[sheet], nodes(NEAR)[0], nodes(BESIDE)[0]
        kernel = kv(0, k * np.abs(x[:, None] - y)) / (2.0 * np.pi) + image(k, x, y)
        block = fluxes(NEAR, a, sheet).T @ kernel @ fluxes(BESIDE, b, sheet)
        expected[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(a.response_to(b), expected, atol=1e-7)
    np.testing.assert_allclose(b.response_to(a), expected.T, atol=1e-7)


def test_a_touch_responds_to_itself(forward):
    """Free of rim by the kernel's eigenvalues on a circle, k a I' K."""
    touch = forward.edge(NEAR)
    k, a = touch.k[0], NEAR.radius_mm / RADIUS_MM
    x = nodes(NEAR)[0]
    flux = fluxes(NEAR, touch, 0)
    expected = flux.T @ image(k, x, x) @ flux
    order = touch.kept_indices[0] % (touch.degree + 1)
    expected += np.diag(k * a * ivp(order, k * a) * kv(order, k * a))
    size = len(order)
    np.testing.assert_allclose(touch.self_response[:size, :size], expected, atol=1e-6)
    assert not touch.self_response[:size, size:].any()


def test_what_electrodes_make_at_a_touch(forward):
    """The whole current of an electrode, by quadrature over its width and height."""
    touch, electrodes = forward.edge(NEAR), forward.electrodes
    first = len(touch.edge.mass)
    t, weight = np.polynomial.legendre.leggauss(12)
    n = np.arange(-60, 61)[:, None]
    x = nodes(NEAR)[0]
    z = (15.0 + 6.0 * t) / RADIUS_MM
    for sheet, kept in enumerate(touch.kept_indices):
        k = touch.k[sheet]
        radial = iv(n, k * np.abs(x)) / (2.0 * np.pi * k * ivp(n, k)) * np.exp(1j * n * np.angle(x))
        up = np.sqrt(2.0) * 0.5 * weight @ np.cos(k * z)
        for electrode in range(8):
            phi = np.radians(45.0 * electrode) + 0.05 * t
            across = 0.5 * weight @ np.exp(-1j * n * phi).T
            expected = up * (across @ radial).real @ fluxes(NEAR, touch, sheet)
            found = touch.coupling[electrode * electrodes.order, first : first + len(kept)]
            np.testing.assert_allclose(found, expected, atol=3e-6)
        first += len(kept)
