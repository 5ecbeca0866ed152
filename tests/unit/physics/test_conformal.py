"""The conformal map of shapes that have one in closed form, and its polynomial."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import polynomial

from eitskin.errors import InputError
from eitskin.physics.conformal import MOST_ORDER, DiscMap, DiscMaps, Series
from eitskin.physics.forward import disc_map
from eitskin.physics.geometry import ROUND_POINTS, Geometry

ROUND = np.exp(2j * np.pi * np.arange(256) / 256)
BETWEEN = 2.0 * np.pi * (np.arange(ROUND_POINTS) + 0.5) / ROUND_POINTS


@pytest.mark.parametrize("centre", [0.0, 0.2, 0.15 - 0.25j])
def test_a_disc_about_another_centre_is_mapped_by_moebius(centre):
    """f(z) of |z - a| < 1 with f(0) = 0, f'(0) > 0, up to the turn that f'(0) > 0 sets."""
    found = DiscMap(centre + ROUND)
    z = 0.6 * ROUND + centre
    w, w0 = z - centre, -centre
    moebius = (w - w0) / (1.0 - np.conj(w0) * w)
    slope = (1.0 - abs(w0) ** 2) / (1.0 - np.conj(w0) * w) ** 2
    np.testing.assert_allclose(found(z), moebius, atol=1e-10)
    np.testing.assert_allclose(found.derivatives(z, 1)[1], slope, atol=1e-8)


@pytest.mark.parametrize(
    "values", [{"stretch_x": 2.0}, {"anisotropy_ratio": 4.0}, {"shape_cos": {1: 0.3}}]
)
def test_far_from_a_disc_the_rim_goes_to_the_circle(values):
    """The largest distance, between the points fitted."""
    geometry = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3, **values)
    between = geometry.unfold(geometry.rim(BETWEEN))
    assert np.abs(np.abs(disc_map(geometry)(between)) - 1.0).max() < 1e-9


@pytest.mark.parametrize("values", [{"stretch_x": np.nan}, {"shape_cos": {2: np.nan}}])
def test_a_rim_that_is_no_number_is_refused(values):
    geometry = Geometry(80.0, 3.0, 0.5, np.arange(16) * 22.5, 5.0, 1e-3, **values)
    with pytest.raises(InputError, match="domain shape"):
        disc_map(geometry)


@given(terms=st.integers(1, 49), scale=st.floats(0.5, 90.0), seed=st.integers(0, 99))
def test_its_polynomial_is_numpys(terms, scale, seed):
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=terms) + 1j * rng.normal(size=terms)
    z = 0.8 * scale * np.exp(1j * rng.uniform(0.0, 6.3, (3, 5)))
    found = Series(coefficients, scale)(z, MOST_ORDER)
    for order, values in enumerate(found):
        own = polynomial.polyder(coefficients, order) / scale**order
        expected = polynomial.polyval(z / scale, own)
        np.testing.assert_allclose(values, expected, rtol=1e-10, atol=1e-10 * np.abs(own).sum())


def test_a_point_is_mapped_alike_whatever_is_beside_it():
    found = DiscMap(80.0 * ROUND * (1.0 + 0.03 * (ROUND**3).real))
    z = 40.0 * np.exp(1j * np.linspace(0.0, 6.0, 5000))
    whole = found.derivatives(z, 2)
    for values, one in zip(whole, found.derivatives(z[4321:4322], 2), strict=True):
        assert values[4321] == one[0]


def test_several_maps_are_each_as_alone():
    rims = [80.0 * ROUND, 75.0 * ROUND * (1.0 + 0.03 * (ROUND**3).real), 0.2 * 80.0 + 80.0 * ROUND]
    maps = [DiscMap(rim) for rim in rims]
    z = 30.0 * np.exp(1j * np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]))
    together = DiscMaps(maps, z).derivatives(z, 2)
    for order, values in enumerate(together):
        alone = [one.derivatives(own, 2)[order] for one, own in zip(maps, z, strict=True)]
        np.testing.assert_allclose(values, alone, rtol=1e-12)
    again = DiscMaps(maps, z).select(np.array([2, 0])).derivatives(z[[2, 0]], 2)
    np.testing.assert_array_equal(again[1], together[1][[2, 0]])
