"""The current density under one contact: a log kernel on a segment with a Robin condition.

On a segment t in [-1, 1], (beta + C) q = f with (C q)(t) = -1/pi int log|t - t'| q(t') dt': the
self-interaction of a contact in the complete electrode model, beta its length z sigma over half the
arc. The density concentrates within beta of the ends, so that it is represented on graded panels;
other contacts interact only with its moments against a few Lagrange polynomials.
"""

import itertools
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

PANEL_NODES = 10  # Gauss nodes: 1e-10 on a panel halved towards a logarithm
HALVINGS = 11  # panels down to 5e-4 of the half arc, below the least beta
LOG_LEVELS = 36  # dyadic panels, down to rounding


def segment_panels(halvings: int = HALVINGS) -> np.ndarray:
    """Panel ends on [-1, 1], halved `halvings` times towards both ends."""
    inner = 1.0 - 0.5 ** np.arange(halvings + 1)
    return np.concatenate([[-1.0], -inner[::-1], inner[1:], [1.0]])


def panel_nodes(ends: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes and weights (panels, order) on the panels between `ends`."""
    node, weight = leggauss(order)
    half = 0.5 * np.diff(ends)[:, None]
    middle = 0.5 * (ends[1:] + ends[:-1])[:, None]
    return middle + half * node, half * weight


def lagrange(points: np.ndarray, order: int) -> np.ndarray:
    """(len(points), order): values of the Lagrange polynomials of the Gauss nodes at points."""
    node, weight = leggauss(order)
    degree = np.arange(order)
    project = (degree + 0.5)[:, None] * legvander(node, order - 1).T * weight
    return legvander(points, order - 1) @ project


def log_weights(place: float, a: float, b: float, order: int) -> np.ndarray:
    """(order,): int_a^b log|place - t| f(t) dt as weights of f at the Gauss nodes of [a, b].

    Exact for polynomials of `order - 1`: dyadic panels towards the point of [a, b] nearest to
    `place`.
    """
    nearest = min(max(place, a), b)
    fractions = np.append(0.0, 0.5 ** np.arange(LOG_LEVELS - 1, -1, -1))
    total = np.zeros(order)
    for end in (a, b):
        if end != nearest:
            u, w = (v.ravel() for v in panel_nodes(fractions, 16))
            t, w = nearest + (end - nearest) * u, np.abs(end - nearest) * w
            local = lagrange((2.0 * t - a - b) / (b - a), order)
            total += (w * np.log(np.abs(place - nearest - (end - nearest) * u))) @ local
    return total


@lru_cache(maxsize=4)
def segment_operator(
    halvings: int = HALVINGS, order: int = PANEL_NODES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes t (N,), weights (N,) and C (N, N) on the graded panels of `order` nodes each."""
    ends = segment_panels(halvings)
    t, w = panel_nodes(ends, order)
    nodes, weights = t.ravel(), w.ravel()
    distance = np.abs(nodes[:, None] - nodes)
    np.fill_diagonal(distance, 1.0)
    operator = np.log(distance) * weights
    for row, place in enumerate(nodes):
        for panel, (a, b) in enumerate(itertools.pairwise(ends)):
            if max(a - place, place - b) < 1.5 * (b - a):
                columns = slice(panel * order, (panel + 1) * order)
                operator[row, columns] = log_weights(place, a, b, order)
    return nodes, weights, -operator / np.pi


@lru_cache(maxsize=4)
def _spectrum(halvings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    operator = segment_operator(halvings)[2]
    values, vectors = np.linalg.eig(operator)
    return values, vectors, np.linalg.inv(vectors)


@lru_cache(maxsize=64)
def _moment_factors(order: int, halvings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    nodes, weights, _ = segment_operator(halvings)
    values, vectors, inverse = _spectrum(halvings)
    local = lagrange(nodes, order)
    return values, (local * weights[:, None]).T @ vectors, inverse @ local


def moment_response(beta: np.ndarray, order: int, halvings: int = HALVINGS) -> np.ndarray:
    """(len(beta), order, order): moments of q for unit values of f at the Gauss nodes.

    Moment j is int q(t) L_j(t) dt, L_j the Lagrange polynomial of node j of `order` Gauss nodes.
    """
    values, moments_of_modes, mode_values = _moment_factors(order, halvings)
    scaled = moments_of_modes[None] / (np.asarray(beta, float)[:, None, None] + values)
    return (scaled @ mode_values).real


def segment_response(beta: np.ndarray, order: int, halvings: int = HALVINGS) -> np.ndarray:
    """(order, order): as `moment_response`, for one segment whose beta (p,) varies along it, given
    at p Gauss nodes."""
    nodes, weights, operator = segment_operator(halvings)
    local = lagrange(nodes, order)
    beta_at_nodes = lagrange(nodes, len(beta)) @ beta
    return (local * weights[:, None]).T @ np.linalg.solve(np.diag(beta_at_nodes) + operator, local)
