"""Two circles of conductivity on the unit disc, crossing or not, by their surface charges.

Shares no code with eitskin. Sheet conductance 1 outside, multiplied by each circle's factor inside
it; point currents on the rim, charges of the image in the rim included. The charge density tau on
either circle obeys tau = -2 q du/dn with u's mean normal derivative, q = (factor - 1) / (factor +
1), also where the circles overlap and factors multiply: k (1 + c) against 1 + c is k against 1.
Nystroem on Gauss-Legendre panels, halved again and again towards the crossings.
"""

from itertools import pairwise

import numpy as np


def circle_nodes(centre, radius, other_centre, other_radius, levels, order=8, panels=64):
    """Nodes, outward normals and arc weights of a circle, graded towards the other one's edge."""
    d = abs(other_centre - centre)
    toward = np.angle(other_centre - centre) if d > 0 else 0.0
    cosine = (d**2 + radius**2 - other_radius**2) / (2 * d * radius) if d > 0 else 2.0
    ends = list(toward + np.linspace(0, 2 * np.pi, panels + 1))
    if abs(cosine) < 1:
        turn = np.arccos(cosine)
        ends = [toward - turn, toward + turn, toward + 2 * np.pi - turn]
        cut = []
        for a, b in pairwise(ends):
            half = 0.5 * (b - a)
            fall = np.concatenate([[0.0], half * 2.0 ** -np.arange(levels, -1.0, -1.0)])
            cut += [a + fall[:-1], (b - fall)[::-1][:-1]]
        ends = [*np.concatenate(cut), ends[-1]]
        fine = []
        for a, b in pairwise(ends):
            fine += list(a + (b - a) * np.arange(2) / 2)
        ends = [*fine, ends[-1]]
    node, weight = np.polynomial.legendre.leggauss(order)
    ends = np.array(ends)
    half = 0.5 * np.diff(ends)[:, None]
    t = (ends[:-1, None] + half * (1 + node)).ravel()
    normal = np.exp(1j * t)
    return centre + radius * normal, normal, (half * weight).ravel() * radius


def log_gradient(x, normal, y):
    """-(1 / 2 pi) d/dn_x (ln|x - y| + ln|1 - x conj(y)|) for x inside, (x, y)."""
    x, normal = x[:, None], normal[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = 1.0 / (x - y) - np.conj(y) / (1.0 - x * np.conj(y))
    return -(slope * normal).real / (2 * np.pi)


def potential(x, y):
    """-(1 / 2 pi) (ln|x - y| + ln|1 - x conj(y)|), (x, y)."""
    x = x[:, None]
    return -(np.log(abs(x - y)) + np.log(abs(1.0 - x * np.conj(y)))) / (2 * np.pi)


def solve(angles, circles, factors, levels=9):
    """Charge nodes (P,), their charges (P, n) per unit current at each rim point, and the rim.

    circles: (centre, radius) of two; factors: what each multiplies the conductivity by.
    """
    rim = np.exp(1j * np.asarray(angles))
    a, b = circles
    parts = [circle_nodes(*a, *b, levels), circle_nodes(*b, *a, levels)]
    nodes, normals, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
    owner = np.repeat([0, 1], [len(part[0]) for part in parts])
    q = np.array([(f - 1.0) / (f + 1.0) for f in factors])[owner]
    own = -1.0 / (4 * np.pi * np.array([a[1], b[1]]))
    kernel = log_gradient(nodes, normals, nodes)
    image = -np.conj(nodes) / (1.0 - nodes * np.conj(nodes))
    np.fill_diagonal(kernel, own[owner] - (image * normals).real / (2 * np.pi))
    # scaled by the square roots of the weights, the panels' shrinking does no harm
    root = np.sqrt(weights)
    system = np.eye(len(nodes)) + 2 * q[:, None] * (root[:, None] * kernel * root)
    source = -2 * q[:, None] * root[:, None] * log_gradient(nodes, normals, rim)
    return nodes, root[:, None] * np.linalg.solve(system, source), rim


def change(angles, circles, factors, levels=9):
    """(n, n): what the circles change of the potentials at the rim points."""
    nodes, charge, rim = solve(angles, circles, factors, levels)
    return potential(rim, nodes) @ charge


def mean_inside(angles, circles, factors, levels=9):
    """(n,): potential at the second circle's centre, where nothing else lies within it."""
    nodes, charge, rim = solve(angles, circles, factors, levels)
    centre = np.array([circles[1][0]])
    return (potential(centre, rim) + potential(centre, nodes) @ charge)[0]
