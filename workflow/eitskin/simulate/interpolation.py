"""Smooth functions of one variable by polynomials through a few of their values."""

from collections.abc import Callable

import numpy as np

TOLERANCE = 1e-9  # of the function's largest value
FIRST = 10.0  # times the error that a line leaves is what the fall of errors begins with


def lobatto(low: float, high: float, count: int) -> np.ndarray:
    """(count,): the extrema of a Chebyshev polynomial and the ends, ascending."""
    unit = np.cos(np.pi * np.arange(count) / (count - 1))[::-1]
    return 0.5 * (low + high) + 0.5 * (high - low) * unit


def lagrange(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(N, K): weights of the values at nodes (K,) in their polynomial at places (N,)."""
    weights = np.ones((len(at), len(nodes)))
    for k, node in enumerate(nodes):
        others = np.delete(nodes, k)
        weights[:, k] = ((at[:, None] - others) / (node - others)).prod(axis=1)
    return weights


def enough_nodes(
    value: Callable[[float], np.ndarray], low: float, high: float, most: int
) -> np.ndarray | None:
    """Nodes (K,) from low to high, K even, whose polynomial is good to TOLERANCE; None where that
    takes more than `most` values.

    Errors fall geometrically with K (Trefethen 2013, Approximation Theory and Approximation
    Practice, ch. 8): two tell how many nodes are enough. They are measured in the middle, which an
    even K leaves out.
    """
    middle = 0.5 * (low + high)
    there = value(middle)
    size = np.nanmax(np.abs(there))
    count, spent = 2, 3
    latest = 0, 1.0 / FIRST
    while spent <= most:
        nodes = lobatto(low, high, count)
        weights = lagrange(nodes, np.array([middle]))[0]
        between = sum(w * value(t) for w, t in zip(weights, nodes, strict=True))
        error = np.nanmax(np.abs(between - there)) / size
        if error < TOLERANCE:
            return nodes
        rate = np.log(error / latest[1]) / (count - latest[0])
        if rate >= 0.0:
            return None
        latest = count, error
        count += 2 * max(1, int(np.ceil(0.5 * np.log(TOLERANCE / error) / rate)))
        spent += count
    return None
