"""Finite elements in three dimensions: quadratic prisms, a disc's triangles times a depth's lines.

They share the disc's mesh with eitskin and nothing of its formulas. Conventions of reference_disc:
radius and conductivity 1, z = contact impedivity times conductivity over the radius.
"""

from itertools import pairwise

import numpy as np
from scipy.sparse import bmat, csc_matrix, diags, kron
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementLineP2, ElementTriP2, FacetBasis, LinearForm, MeshLine
from skfem.helpers import dot, grad

from symmetric_mesh import symmetric_disc_mesh


@BilinearForm
def stiffness(u, v, w):
    return w.get("factor", 1.0) * dot(grad(u), grad(v))


@BilinearForm
def mass(u, v, w):
    return w.get("factor", 1.0) * u * v


@LinearForm
def total(v, w):
    return w.get("factor", 1.0) * v


def graded_line(depth, low, high, cells, halvings):
    """Places 0 ... depth: `cells` a piece between electrode edges, halved towards each of them."""
    edges = np.unique([0.0, low, high, depth])
    places = []
    for a, b in pairwise(edges):
        inner = np.linspace(0.0, 1.0, cells + 1)
        first = inner[1] * 0.5 ** np.arange(1, halvings + 1)
        places.append(a + (b - a) * np.unique([*inner, *first, *(1.0 - first)]))
    return np.unique(np.concatenate(places).round(12))


def body_impedance(n, width, z, depth, low, high, mesh=(1, 2), line=(2, 2), inclusion=None):
    """Transfer impedance (n, n): electrodes from height `low` to `high`.

    mesh: refinement and grading of the disc; line: cells a piece and halvings; inclusion: radius
    and conductivity of a concentric cylinder through the whole depth.
    """
    rings = () if inclusion is None else (inclusion[0],)
    disc, facets = symmetric_disc_mesh(n, width, *mesh, rings)
    basis = Basis(disc, ElementTriP2(), intorder=6)
    factor = np.ones(disc.nelements)
    if inclusion is not None:
        middle = disc.p[:, disc.t].mean(axis=1)
        factor[np.hypot(*middle) < inclusion[0]] = inclusion[1]
    factor = factor[:, None] * np.ones((1, basis.X.shape[-1]))
    upright = MeshLine(graded_line(depth, low, high, *line))
    up = Basis(upright, ElementLineP2(), intorder=4)
    face = (upright.p[0, upright.t].mean(axis=0) > low) & (
        upright.p[0, upright.t].mean(axis=0) < high
    )
    on_face = Basis(upright, ElementLineP2(), intorder=4, elements=np.flatnonzero(face))
    flat = (stiffness.assemble(basis, factor=factor), mass.assemble(basis, factor=factor))
    body = kron(flat[0], mass.assemble(up)) + kron(flat[1], stiffness.assemble(up))
    couplings, areas = [], []
    for sides in facets:
        rim = FacetBasis(disc, ElementTriP2(), facets=sides, intorder=6)
        body = body + kron(mass.assemble(rim), mass.assemble(on_face)) / z
        flux = np.kron(total.assemble(rim), total.assemble(on_face)) / z
        couplings.append(-flux)
        areas.append(flux.sum())
    coupling = csc_matrix(np.array(couplings).T)
    system = bmat([[body, coupling], [coupling.T, diags(areas)]], "csc")
    size = system.shape[0]
    drive = np.zeros((size - 1, n))
    drive[size - n + np.arange(n - 1), np.arange(n - 1)] = 1.0
    factors = splu(
        system[:-1, :-1].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    potential = factors.solve(drive)
    impedance = np.zeros((n, n))
    impedance[:-1] = potential[size - n :]
    return impedance
