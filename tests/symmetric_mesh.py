"""A disc meshed with the skin's own symmetry, for finite elements that bear witness."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from skfem import MeshTri, MeshTri2

from benchmark.finite_elements import straight_mesh
from eitskin.errors import InputError


def symmetric_disc_mesh(
    n_electrodes: int,
    width: float,
    refinement: int,
    grading: int,
    rings: tuple[float, ...] = (),
) -> tuple[MeshTri2, list[np.ndarray] | np.ndarray]:
    """Unit disc meshed with the skin's own symmetry: n-fold rotation and its mirrors.

    n_electrodes: n >= 3, electrode l centred at angle 2 pi l / n. width: arc of each in rad, or 0.
    refinement: how often every triangle is split in four. grading: how often triangles near the
    electrode edges are halved before that. rings: radii of circles that element sides follow.
    Returns the mesh (rim and rings exact at nodes and middles of sides) and the facets of each
    electrode, or the electrodes' nodes (n,) where the width is 0. One half sector is meshed; its
    rotations and mirror images are the rest.
    Raises InputError where electrodes overlap or a ring lies outside the disc.
    """
    half = np.pi / n_electrodes
    if n_electrodes < 3 or not 0 <= width < 2 * half:
        raise InputError(
            "mesh", "electrodes", f"{n_electrodes} of {width} rad", "3 or more that do not overlap"
        )
    if any(not 0 < ring < 1 for ring in rings):
        raise InputError("mesh", "rings", rings, "radii between 0 and 1")
    wedge = _half_sector(half, width, refinement, grading, rings)
    nodes, elements = _rotated(wedge, n_electrodes, half)
    mesh = MeshTri2.from_mesh(straight_mesh(nodes, elements))

    doflocs = mesh.doflocs.copy()
    radius = np.hypot(*nodes.T)
    middles = mesh.dofs.facet_dofs[0]
    for ring in (*rings, 1.0):
        on_ring = np.flatnonzero(np.all(abs(radius[mesh.facets] - ring) < 1e-12, axis=0))
        place = doflocs[:, middles[on_ring]]
        doflocs[:, middles[on_ring]] = ring * place / np.hypot(*place)
    mesh = replace(mesh, doflocs=doflocs)

    centres = 2 * half * np.arange(n_electrodes)
    if width == 0:
        offset = nodes[:, None] - np.column_stack([np.cos(centres), np.sin(centres)])
        return mesh, (offset**2).sum(axis=-1).argmin(axis=0)
    rim = mesh.boundary_facets()
    angle = np.arctan2(*doflocs[::-1, middles[rim]])
    electrodes = []
    for centre in centres:
        distance = abs((angle - centre + np.pi) % (2 * np.pi) - np.pi)
        electrodes.append(rim[distance < width / 2])
    return mesh, electrodes


def _half_sector(
    half: float, width: float, refinement: int, grading: int, rings: tuple[float, ...]
) -> MeshTri:
    """Half a sector, in the plane of r and r theta: there its circles and rays are straight."""
    breaks = np.array([0.0, *sorted(rings), 1.0])
    radii = [0.0]
    for inner, outer in pairwise(breaks):
        radii.extend(np.linspace(inner, outer, int(np.ceil((outer - inner) / 0.25)) + 1)[1:])
    nodes = [(0.0, 0.0)]
    triangles = [(0, 1, 2)]
    for layer, r in enumerate(radii[1:-1]):
        nodes.extend([(r, 0.0), (r, r * half)])
        if layer > 0:
            a = 2 * layer - 1
            triangles.extend([(a, a + 2, a + 3), (a, a + 3, a + 1)])
    a = len(nodes) - 2
    if width > 0:
        nodes.extend([(1.0, 0.0), (1.0, width / 2), (1.0, half)])
        triangles.extend([(a, a + 2, a + 3), (a, a + 3, a + 1), (a + 1, a + 3, a + 4)])
    else:
        nodes.extend([(1.0, 0.0), (1.0, half)])
        triangles.extend([(a, a + 2, a + 3), (a, a + 3, a + 1)])

    mesh = straight_mesh(np.array(nodes), np.array(triangles))
    edge = np.array([[1.0], [width / 2]])
    for _ in range(grading):
        sides = mesh.p[:, mesh.t] - mesh.p[:, np.roll(mesh.t, 1, axis=0)]
        size = np.sqrt((sides**2).sum(axis=0)).max(axis=0)
        distance = np.sqrt(((mesh.p[:, mesh.t] - edge[:, None]) ** 2).sum(axis=0)).min(axis=0)
        mesh = mesh.refined(np.flatnonzero(size > distance))
    return mesh.refined(refinement) if refinement else mesh


def _rotated(wedge: MeshTri, n: int, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (P, 2) and elements (E, 3) of the disc from its half sector, shared nodes once."""
    r, arc = wedge.p
    angle = np.divide(arc, r, out=np.zeros_like(arc), where=r > 0)
    size = len(r)
    centre = r == 0
    first_ray = abs(angle) < 1e-12
    last_ray = abs(angle - half) < 1e-12
    r = np.where(abs(r - 1.0) < 1e-12, 1.0, r)

    copies = np.arange(2 * n * size).reshape(n, 2, size)
    copies[:, 1, first_ray] = copies[:, 0, first_ray]
    copies[:, 1, last_ray] = np.roll(copies[:, 0, last_ray], 1, axis=0)
    copies[:, :, centre] = copies[0, 0, centre]
    turn = 2 * half * np.arange(n)[:, None]
    turned = np.stack([turn + angle, turn - angle], axis=1)
    nodes = np.stack([r * np.cos(turned), r * np.sin(turned)], axis=-1).reshape(-1, 2)
    kept, elements = np.unique(copies[:, :, wedge.t], return_inverse=True)
    elements = elements.reshape(n, 2, 3, -1).transpose(0, 1, 3, 2).reshape(-1, 3)
    return nodes[kept], elements
