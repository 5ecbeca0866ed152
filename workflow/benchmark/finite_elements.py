"""Finite elements on triangles, the sheet conductance given element by element.

For whatever no formula covers (images, any mesh, any outline) and as an independent witness of the
exact forward model. scikit-fem assembles; the factors are SciPy's.
"""

from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import bmat, csc_matrix, diags
from scipy.sparse.linalg import SuperLU, splu
from skfem import (
    Basis,
    BilinearForm,
    ElementTriP1,
    ElementTriP2,
    FacetBasis,
    LinearForm,
    MappingIsoparametric,
    MeshTri,
    MeshTri2,
)
from skfem.helpers import dot, grad

from eitskin.errors import InputError
from eitskin.physics.forward import TouchModes, channel_values

ELEMENT_TYPES = {1: ElementTriP1, 2: ElementTriP2}
LARGEST_RESIDUAL = 1e-9


@BilinearForm
def _laplace(u, v, _):
    return dot(grad(u), grad(v))


@BilinearForm
def _mass(u, v, _):
    return u * v


@LinearForm
def _flux(v, _):
    return 1.0 * v


class _RimMapping(MappingIsoparametric):
    """Isoparametric mapping whose inverse allows for the rounding of small graded elements.

    scikit-fem asks for 1e-12 of the element, which coordinates near 1 cannot give to elements
    below 1e-3; Newton's last step is quadratic, so that what remains is rounding alone.
    """

    def invF(self, x: np.ndarray, tind: np.ndarray | None = None) -> np.ndarray:
        return super().invF(x, tind, newton_tol=1e-7)


class FiniteElements:
    """Transfer impedances of a triangulated sheet.

    mesh: skfem MeshTri (straight) or MeshTri2 (quadratic, curved rim); any unit of length, here m.
    electrodes: node numbers (n,) for points; a list of n arrays of facet numbers for complete
    electrodes. contact: None for points, else z/h in ohm m, one number or (n,). order: 1 or 2.
    Raises InputError where these do not fit together.

    Complete electrodes (Somersalo, Cheney and Isaacson 1992): current density (U_l - u) h/z on
    electrode l, none elsewhere.
    """

    def __init__(
        self,
        mesh: MeshTri | MeshTri2,
        electrodes: np.ndarray | list[np.ndarray],
        contact: float | np.ndarray | None = None,
        order: int = 1,
    ):
        if order not in ELEMENT_TYPES:
            raise InputError("finite elements", "order", order, f"one of {list(ELEMENT_TYPES)}")
        self.mesh = mesh
        self.n_electrodes = len(electrodes)
        self.basis = Basis(mesh, ELEMENT_TYPES[order](), intorder=2 * order)
        self._local = _laplace.coo_data(self.basis)
        if contact is None:
            self._point_electrodes(np.asarray(electrodes))
        else:
            self._complete_electrodes(electrodes, contact)

    def _point_electrodes(self, nodes: np.ndarray) -> None:
        if nodes.ndim != 1 or len(np.unique(nodes)) < len(nodes) or len(nodes) < 2:
            raise InputError("finite elements", "electrodes", nodes.shape, "two nodes or more")
        self._size = self.basis.N
        self._terminals = self.basis.nodal_dofs[0, nodes]
        self._contact_matrix = csc_matrix((self._size, self._size))

    def _complete_electrodes(self, electrodes: list[np.ndarray], contact: float | np.ndarray):
        n = self.n_electrodes
        impedance = np.asarray(contact, dtype=float)
        if impedance.ndim > 1 or impedance.size not in (1, n) or not np.all(impedance > 0):
            raise InputError("finite elements", "contact", contact, f"above 0, one or {n}")
        impedance = np.broadcast_to(impedance, n)
        boundary = set(self.mesh.boundary_facets().tolist())
        robin = csc_matrix((self.basis.N, self.basis.N))
        mapping = None
        if isinstance(self.mesh, MeshTri2):
            mapping = _RimMapping(self.mesh, self.mesh.elem(), self.mesh.bndelem)
        couplings, lengths = [], []
        for number, (facets, z) in enumerate(zip(electrodes, impedance, strict=True)):
            if len(facets) == 0 or not boundary.issuperset(np.asarray(facets).tolist()):
                raise InputError(
                    "finite elements", f"electrodes[{number}]", facets, "facets on the boundary"
                )
            rim = FacetBasis(
                self.mesh,
                self.basis.elem,
                mapping=mapping,
                facets=facets,
                intorder=2 * self.basis.elem.maxdeg + 2,
            )
            flux = _flux.assemble(rim) / z
            robin = robin + _mass.assemble(rim) / z
            couplings.append(-flux)
            lengths.append(flux.sum())
        coupling = csc_matrix(np.array(couplings).T)
        self._size = self.basis.N + n
        self._terminals = self.basis.N + np.arange(n)
        self._contact_matrix = bmat([[robin, coupling], [coupling.T, diags(lengths)]], "csc")

    def stiffness(self, conductance: np.ndarray) -> csc_matrix:
        """System matrix in S for `conductance` (elements,) in S, contacts included, ungrounded."""
        conductance = np.asarray(conductance, dtype=float)
        expected = (self.mesh.nelements,)
        if conductance.shape != expected or not np.all(np.isfinite(conductance)):
            raise InputError(
                "finite elements", "conductance", conductance.shape, f"finite numbers {expected}"
            )
        if conductance.min() <= 0:
            raise InputError("finite elements", "conductance", conductance.min(), "more than 0")
        repeats = len(self._local.data) // self.mesh.nelements
        data = self._local.data * np.tile(conductance, repeats)
        body = csc_matrix((data, self._local.indices), shape=(self._size, self._size))
        return body + self._contact_matrix

    def factored(self, conductance: np.ndarray) -> "FactoredElements":
        """Factor the system once; `conductance` as in `stiffness`."""
        return FactoredElements(self, np.asarray(conductance, dtype=float))

    def transfer_impedance(self, conductance: np.ndarray) -> np.ndarray:
        """Transfer impedance (n, n) in ohm; rows and columns sum to 0 (sum of U is 0).

        [i, j]: potential of electrode i for a unit current into j, drawn evenly from them all.
        """
        return self.factored(conductance).transfer_impedance

    def voltages(self, conductance: np.ndarray, channels: np.ndarray, current: float) -> np.ndarray:
        """Voltages (M,) in V of channels (M, 4) source, sink, plus, minus at `current` in A."""
        return current * channel_values(self.transfer_impedance(conductance), np.asarray(channels))


class FactoredElements:
    """A sheet of known conductance (elements,) in S, factored: solves, impedance and touches.

    Solving raises InputError where elements are so thin that rounding spoils the fields.
    """

    def __init__(self, elements: FiniteElements, conductance: np.ndarray):
        self.elements = elements
        self.conductance = conductance
        self._ground = elements._terminals[-1]
        self._kept = np.delete(np.arange(elements._size), self._ground)
        self._matrix = elements.stiffness(conductance)[self._kept][:, self._kept].tocsc()
        self._factors: SuperLU = splu(
            self._matrix,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def solve(self, currents: np.ndarray) -> np.ndarray:
        """Potentials (unknowns, P) in V for `currents` (unknowns, P) in A, last electrode at 0."""
        potentials = np.zeros_like(currents)
        potentials[self._kept] = self._factors.solve(currents[self._kept])
        return potentials

    @cached_property
    def fields(self) -> np.ndarray:
        """Potentials (unknowns, n) in ohm: unit current into each electrode, out of the last."""
        terminals = self.elements._terminals
        currents = np.zeros((self.elements._size, len(terminals)))
        currents[terminals, np.arange(len(terminals))] = 1.0
        fields = self.solve(currents)
        lost = np.max(abs(self._matrix @ fields[self._kept] - currents[self._kept]))
        if not lost < LARGEST_RESIDUAL:
            raise InputError(
                "finite elements", "mesh", f"{lost:.1e} of a current lost", "no slivers"
            )
        return fields

    @cached_property
    def transfer_impedance(self) -> np.ndarray:
        """Transfer impedance (n, n) in ohm, as `FiniteElements.transfer_impedance`."""
        grounded = self.fields[self.elements._terminals]
        centred = grounded - grounded.mean(axis=0)
        return centred - centred.mean(axis=1, keepdims=True)

    def touch_modes(self, touched: np.ndarray) -> TouchModes:
        """Modes of a touch on the elements `touched` (numbers), all multiplied by 1 + c.

        The stiffness changes by c L L^T on the touched elements' nodes alone, so by Woodbury's
        identity R(c) = R(0) - c F^T L (1 + c L^T A^-1 L)^-1 L^T F, with the electrodes' fields F;
        the eigenvectors of L^T A^-1 L separate it.
        """
        touched = np.asarray(touched)
        if touched.size == 0:
            return TouchModes(np.zeros((self.elements.n_electrodes, 0)), np.zeros(0))
        dofs = self.elements.basis.element_dofs[:, touched]
        nodes, position = np.unique(dofs, return_inverse=True)
        position = position.reshape(dofs.shape)
        local = self.elements._local.tolocal()[touched] * self.conductance[touched, None, None]
        change = np.zeros((len(nodes), len(nodes)))
        np.add.at(change, (position.T[:, :, None], position.T[:, None, :]), local)
        values, vectors = eigh(change)
        carried = values > values[-1] * len(nodes) * np.finfo(float).eps
        root = vectors[:, carried] * np.sqrt(values[carried])

        currents = np.zeros((self.elements._size, root.shape[1]))
        currents[nodes] = root
        potentials = self.solve(currents)[nodes]
        d, turned = eigh(root.T @ potentials)
        fields = self.fields[nodes] - self.fields[nodes].mean(axis=1, keepdims=True)
        g = fields.T @ root @ turned
        seen = (g**2).sum(axis=0) > np.finfo(float).eps * (g**2).sum()
        return TouchModes(g[:, seen], d[seen])


def straight_mesh(nodes: np.ndarray, elements: np.ndarray) -> MeshTri:
    """Mesh of straight triangles: nodes (P, 2) in m, elements (E, 3) node numbers, order kept."""
    return MeshTri(
        np.ascontiguousarray(np.asarray(nodes, dtype=float)[:, :2].T),
        np.ascontiguousarray(np.asarray(elements, dtype=np.int64).T),
    )


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
