"""Polynomials through a few values of a smooth function."""

import numpy as np
import pytest

from eitskin.simulate.interpolation import TOLERANCE, enough_nodes, lagrange, lobatto


def test_weights_reproduce_polynomials():
    nodes, at = lobatto(-1.0, 3.0, 6), np.linspace(-1.0, 3.0, 11)
    weights = lagrange(nodes, at)
    assert np.allclose(weights.sum(axis=1), 1.0, atol=1e-13)
    assert np.allclose(weights @ nodes**5, at**5, rtol=1e-12)
    assert np.allclose(lagrange(nodes, nodes), np.eye(6), atol=1e-14)
    assert np.array_equal(lagrange(np.array([2.0]), at), np.ones((11, 1)))


@pytest.mark.parametrize("rise", [1e-6, 1e-3, 0.1, 1.0, 5.0])
def test_enough_nodes_are_enough(rise):
    def value(t):
        return np.array([1.0 / (1.0 + rise * t), np.nan, 3.0 + np.sqrt(1.0 + rise * t)])

    nodes = enough_nodes(value, 0.0, 2.0, 500)
    at = np.linspace(0.0, 2.0, 101)
    between = lagrange(nodes, at) @ np.array([value(t) for t in nodes])
    exact = np.array([value(t) for t in at])
    assert np.nanmax(np.abs(between - exact)) < 30 * TOLERANCE
    assert len(nodes) % 2 == 0 and (nodes[0], nodes[-1]) == (0.0, 2.0)


def test_more_nodes_where_more_changes():
    counts = [
        len(enough_nodes(lambda t, r=rise: np.exp(r * np.array([t])), 0.0, 1.0, 500))
        for rise in (1e-5, 1e-2, 0.3)
    ]
    assert counts == sorted(counts) and counts[0] == 2 < counts[-1]


@pytest.mark.parametrize("value", [lambda t: np.abs([t - 0.3]), lambda t: np.sign([t - 0.4])])
def test_what_is_not_smooth_is_given_up(value):
    asked = []

    def counted(t):
        asked.append(t)
        return value(t)

    assert enough_nodes(counted, -1.0, 2.0, 40) is None
    assert len(asked) <= 41
