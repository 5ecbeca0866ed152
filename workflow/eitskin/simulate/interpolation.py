"""Smooth functions of one variable by polynomials through a few of their values."""

from collections.abc import Callable

import numpy as np

TOLERANCE = 1e-9  # of the function's largest value
FIRST_ERROR = 0.1  # relative error assumed at 0 nodes, for the first rate of decay


def lobatto(low: float, high: float, count: int) -> np.ndarray:
    """(count,): the extrema of a Chebyshev polynomial and the ends, ascending."""
    unit = np.cos(np.pi * np.arange(count) / (count - 1))[::-1]
    return 0.5 * (low + high) + 0.5 * (high - low) * unit


def lagrange(nodes: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(N, K): weights of the values at nodes (K,) in their interpolating polynomial at places
    (N,)."""
    weights = np.ones((len(places), len(nodes)))
    for k, node in enumerate(nodes):
        other_nodes = np.delete(nodes, k)
        weights[:, k] = ((places[:, None] - other_nodes) / (node - other_nodes)).prod(axis=1)
    return weights


def enough_nodes(
    value: Callable[[float], np.ndarray], low: float, high: float, most_values: int
) -> np.ndarray | None:
    """Nodes (K,) from low to high, K even, whose interpolating polynomial meets TOLERANCE; None
    where that takes more than `most_values` evaluations.

    Errors fall geometrically with K (Trefethen 2013, Approximation Theory and Approximation
    Practice, ch. 8), so that two of them tell the K needed. They are measured in the middle, which
    is no node for even K.
    """
    middle = 0.5 * (low + high)
    middle_value = value(middle)
    size = np.nanmax(np.abs(middle_value))
    count, values_used = 2, 3
    previous = 0, FIRST_ERROR
    while values_used <= most_values:
        nodes = lobatto(low, high, count)
        weights = lagrange(nodes, np.array([middle]))[0]
        interpolated = sum(w * value(t) for w, t in zip(weights, nodes, strict=True))
        error = np.nanmax(np.abs(interpolated - middle_value)) / size
        if error < TOLERANCE:
            return nodes
        rate = np.log(error / previous[1]) / (count - previous[0])
        if rate >= 0.0:
            return None
        previous = count, error
        count += 2 * max(1, int(np.ceil(0.5 * np.log(TOLERANCE / error) / rate)))
        values_used += count
    return None
